"""StaInf: cells look where the camera sees, and an answer that is right costs nothing."""

from __future__ import annotations

import torch
from orbisim_diffusion.inference import (
    Dense,
    StateInference,
    errors,
    inference_loss,
    robots,
    truth,
)
from orbisim_diffusion.solids import project
from orbisim_diffusion.train_inference import alike

from tests.backends.diffusion.tiny import arm, store_of


def test_cells_look_at_the_table_where_the_camera_sees_them() -> None:
    store = store_of(arm(), frames=1)
    model = StateInference(4, 32)
    view = store.view(torch.tensor([0]))
    model.look_from(view)
    place, _ = project(view, model.base[None])
    cells = (torch.arange(model.cells) + 0.5) / model.cells - 0.5
    # the rotation of these stores is orthonormal to 0.5 %
    table = (model.base[:, 2] - 0.025).abs() < 1e-5  # the others look above the horizon
    assert table.sum() >= model.cells**2 // 2
    rows, columns = torch.meshgrid(cells, cells, indexing="ij")
    expected = torch.stack([columns, rows], -1).flatten(0, 1)
    torch.testing.assert_close(place[0][table], expected[table], atol=0.01, rtol=0)


def test_the_right_answer_costs_nothing_and_is_read_off_again() -> None:
    store = store_of(arm(), frames=3)
    index = torch.arange(3)
    model, true, view = StateInference(4, 32), truth(store, robots(store), index), store.view(index)
    model.look_from(view)
    place = ((project(view, true.pos)[0] + 0.5) * model.cells).long()
    assert true.there[:, 0].all() and not true.there[:, 1:].any()  # one cube
    grid = torch.zeros(3, 16, model.cells, model.cells)
    grid[:, 0] = -12.0
    for i in range(3):
        column, row = (int(v) for v in place[i, 0])
        base = model.base[row * model.cells + column]
        grid[i, 0, row, column] = 12.0
        grid[i, 1:4, row, column] = (true.pos[i, 0] - base) / 0.1
        grid[i, 4:10, row, column] = true.rot[i, 0][:, :2].T.flatten()
        grid[i, 10:13, row, column] = (true.size[i, 0] / 0.025).log()
        grid[i, 13:16, row, column] = true.colour[i, 0].logit()
    robot = torch.cat(
        [
            (true.hand_pos - torch.tensor([0.5, 0.0, 0.1])) / 0.3,
            true.hand_rot[..., :2].transpose(-1, -2).flatten(1),
            true.joints.sin(),
            true.joints.cos(),
        ],
        dim=1,
    )
    found = Dense(robot, grid)
    assert float(inference_loss(model, found, true, view)) < 1e-3
    wrong = Dense(robot, grid.clone())
    wrong.grid[:, 1] += 0.2 * (wrong.grid[:, 0] > 0)  # 2 cm along x
    assert float(inference_loss(model, wrong, true, view)) > 0.1
    model.dense = lambda _: found  # type: ignore[method-assign]
    read = errors(model(torch.zeros(3, 4, 4, 4)), true)
    assert read["object_position_mm"] < 1e-2 and read["count_right_percent"] == 100.0
    around = true._replace(joints=true.joints + 2 * torch.pi)  # a turn more looks the same
    assert errors(model(torch.zeros(3, 4, 4, 4)), around)["joint_rad"] < 1e-4


def test_only_frames_of_one_camera_are_alike() -> None:
    store = store_of(arm(), frames=4, episodes=2)
    store.view_pos[2] += 0.1
    assert alike(store).tolist() == [0, 1, *range(3, len(store))]
