"""The scenes in mjcf_assets against measured data, where the data are at hand.

The data folder is named by ORBISIM_MEASURED_DATA, or lies beside the repository in
shared/data/measured. Figures are those that this replay gives; references that others measured on
the same data are given where they exist.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

import orbisim
from orbisim import Recording, load_scene
from orbisim.recording import bind, smooth

REPOSITORY = Path(__file__).resolve().parent.parent
DATA = Path(
    os.environ.get("ORBISIM_MEASURED_DATA") or REPOSITORY.parent / "shared" / "data" / "measured"
)
ASSETS = REPOSITORY / "mjcf_assets"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data in {DATA}")


def importer():
    spec = importlib.util.spec_from_file_location(
        "import_measured", REPOSITORY / "tools" / "import_measured.py"
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["import_measured"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """Folder of the recordings of every data set that is there."""
    out = tmp_path_factory.mktemp("recordings")
    result = CliRunner().invoke(importer().main, [str(DATA), str(out)])
    assert result.exit_code == 0, result.output
    return out


def recordings(imported, name, pattern="*", every=1):
    paths = sorted((imported / name).glob(f"{pattern}.npz"))[::every]
    if not paths:
        pytest.skip(f"no data for {name}")
    return [Recording.load(path) for path in paths]


def scenes(name):
    return [load_scene(ASSETS / name / f"{kind}.xml") for kind in ("scene", "published")]


def before_and_after(name, recordings, window, score, **options):
    """A score of the declared and of the published scene."""
    return [
        score(orbisim.replay(scene, recordings, window=window, **options)) for scene in scenes(name)
    ]


def mean_window_rms(signal):
    def score(result):
        return np.mean([np.sqrt(np.nanmean(w.error[signal] ** 2)) for w in result.windows])

    return score


# -- the tool --------------------------------------------------------------------------------------


def test_every_recording_fits_its_scene(imported):
    for split in sorted(imported.glob("*/split.json")):
        content = json.loads(split.read_text())
        scene = load_scene(REPOSITORY / content["scene"])
        names = content["fit"] + content["held_out"]
        assert content["fit"]
        assert content["held_out"]
        assert sorted(names) == sorted(p.name for p in split.parent.glob("*.npz"))
        for name in names[:: max(1, len(names) // 5)]:
            bound = bind(Recording.load(split.parent / name), scene)
            assert np.isfinite(bound.qpos).all(), name


def test_recordings_do_not_go_into_the_repository():
    result = CliRunner().invoke(importer().main, [str(DATA), str(REPOSITORY / "out")])
    assert result.exit_code == 2
    assert "inside the repository" in result.output


# -- one test for each data set --------------------------------------------------------------------


def test_emps(imported):
    """Reference: force residual 70 % of the motor force before, 3.6 % after."""
    parts = recordings(imported, "emps")
    a, b = before_and_after("emps", parts, 0.5, lambda result: result.rms)
    assert a == pytest.approx(0.0216, rel=0.05)
    assert b == pytest.approx(0.00063, rel=0.1)
    fit = next(p for p in parts if p.time[0] == 0)
    found = smooth(fit.time, fit["qpos/carriage"])
    force = 35.1507 * fit["ctrl/drive"]
    left = force - 95.11 * found.second
    model = 203.5 * found.rate + 20.39 * np.tanh(found.rate / 1e-3) - 3.16
    inside = slice(50, -50)

    def part(residual):
        return np.sqrt(np.mean(residual[inside] ** 2) / np.mean(force[inside] ** 2))

    assert part(left) == pytest.approx(0.70, abs=0.03)
    assert part(left - model) < 0.05


def test_dfki_simple_pendulum(imported):
    """Reference: ddp 0.185 rad before, 0.078 after, in windows of 1 s."""
    (ddp,) = recordings(imported, "dfki_simple_pendulum", "ddp")

    def away_from_upright(result):
        rms = []
        for window in result.windows:
            angle = ddp["qpos/hinge"][window.start : window.stop]
            if (np.cos(angle) + 1).min() > 0.05:  # open loop, the upright position is unstable
                rms.append(window.rms)
        return np.mean(rms)

    a, b = before_and_after(
        "dfki_simple_pendulum", ddp, 1.0, away_from_upright, velocities="smoothed"
    )
    assert a == pytest.approx(0.199, rel=0.1)
    assert b == pytest.approx(0.078, rel=0.15)


def test_dfki_double_pendulum(imported):
    """Reference: 0.100 and 0.342 rad before, 0.025 and 0.081 after, in windows of 0.5 s."""
    parts = recordings(imported, "dfki_double_pendulum_A", "sysid_*")
    name = "dfki_double_pendulum_A"
    shoulder = before_and_after(name, parts, 0.5, mean_window_rms("qpos/shoulder"))
    elbow = before_and_after(name, parts, 0.5, mean_window_rms("qpos/elbow"))
    assert shoulder == [pytest.approx(0.099, rel=0.05), pytest.approx(0.027, rel=0.1)]
    assert elbow == [pytest.approx(0.336, rel=0.05), pytest.approx(0.082, rel=0.1)]


def test_multiarm_single(imported):
    """Reference: 0.196 rad before, 0.054 after, in windows of 5 s."""
    parts = recordings(imported, "multiarm_pendulum_single", "single_0*")
    found = before_and_after("multiarm_pendulum_single", parts, 5.0, mean_window_rms("qpos/arm"))
    assert found == [pytest.approx(0.1955, rel=0.03), pytest.approx(0.0554, rel=0.05)]


def test_multiarm_double(imported):
    parts = recordings(imported, "multiarm_pendulum_double")
    a, b = before_and_after(
        "multiarm_pendulum_double", parts, 0.5, lambda r: r.signals["qpos/lower"].median
    )
    assert a == pytest.approx(0.0037, rel=0.1)
    assert b == pytest.approx(0.0030, rel=0.1)


def test_contactnets_cube(imported):
    """Reference: median position error after 0.5 s 166 mm before, 44 mm after (400 tosses)."""
    parts = recordings(imported, "contactnets_cube", every=8)

    def at_half_a_second(result):
        rows = [np.abs(w.time - w.time[0] - 0.5).argmin() for w in result.windows]
        errors = [w.error["xpos/cube"][r] for w, r in zip(result.windows, rows, strict=True)]
        return np.median(errors)

    found = before_and_after("contactnets_cube", parts, 0, at_half_a_second)
    assert found == [pytest.approx(0.166, rel=0.2), pytest.approx(0.044, rel=0.3)]


def test_table_tennis_ball(imported):
    """Reference: 0.317 m before and 0.083 m after at the end of the first flight."""
    parts = recordings(imported, "table_tennis_ball", every=4)
    ends = [importer().first_bounce(p["xpos/ball"][:, 2]) - 2 for p in parts]

    def end_of_flight(result):
        return np.median(
            [w.error["xpos/ball"][end] for w, end in zip(result.windows, ends, strict=True)]
        )

    a, b = before_and_after("table_tennis_ball", parts, 0, end_of_flight)
    assert 0.10 < a < 0.30
    assert b < 0.5 * a


TANH = np.array([1146, 47299, 10086, 3784, 4043, 3966.0])
COULOMB = np.array([31.6, 117.5, 85.7, 49.7, 111.1, 5.3])
STEEP = np.array([318.6, 420.7, 291.5, 43.9, 13.8, 82.4])


def test_kuka_torques(imported):
    """Measured joint torques less those that the scene needs for the measured motion.

    Reference, N*m: 799 1191 2236 167 510 226 before, 178 360 383 61 52 42 after.
    """
    (part,) = recordings(imported, "kuka_kr300", "trajectory_A")
    q = np.stack([part[f"qpos/axis_{i}"] for i in range(1, 7)], axis=1)
    motion = smooth(part.time, q)
    left = []
    for scene in scenes("kuka_kr300"):
        model = scene.model
        gear, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 0]
        measured = np.stack([part[f"ctrl/motor_{i}"] for i in range(1, 7)], axis=1) * gear + bias
        viscous, dry = model.dof_damping.copy(), model.dof_frictionloss.any()
        model.dof_damping[:] = model.dof_frictionloss[:] = 0  # added below as published
        data = mujoco.MjData(model)
        for row in range(len(q)):
            data.qpos[:], data.qvel[:] = q[row], motion.rate[row]
            data.qacc[:] = motion.second[row]
            mujoco.mj_inverse(model, data)
            measured[row] -= data.qfrc_inverse
        friction = viscous * motion.rate
        if dry:
            friction += COULOMB * np.tanh(100 * motion.rate) + STEEP * np.tanh(TANH * motion.rate)
        left.append(np.sqrt(np.mean((measured - friction) ** 2, axis=0)))
    np.testing.assert_allclose(left[0], [799, 1191, 2236, 167, 510, 226], rtol=0.05)
    assert (left[1] < 1.4 * np.array([178, 360, 383, 61, 52, 42])).all()


def test_kuka_windows(imported):
    parts = recordings(imported, "kuka_kr300")
    a, b = before_and_after("kuka_kr300", parts, 0.2, lambda result: result.rms)
    assert a == pytest.approx(0.065, rel=0.1)
    assert b < 0.2 * a


def test_sts3215(imported):
    """Held at home, the shaft stands 5 to 12 mrad to the side it is pulled to; the scene has 3."""
    (part,) = recordings(imported, "sts3215_backlash", "single*")
    scene = load_scene(ASSETS / "sts3215_backlash" / "scene.xml")
    held = (part["ctrl/servo"] == 0) & (np.abs(part["ctrl/pull"]) > 0.25)
    signed = part["qpos/shaft"][held] * np.sign(part["ctrl/pull"][held])
    assert 0.008 < np.median(signed) < 0.016
    result = orbisim.replay(scene, part, window=0)
    simulated = result.windows[0].qpos[held, 0] * np.sign(part["ctrl/pull"][held])
    assert np.median(simulated) < 0.004
