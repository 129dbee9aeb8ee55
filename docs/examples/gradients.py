"""Gradients through a backend: fit a control sequence by gradient descent in torch."""

import torch

import orbisim
from orbisim.gradients import rollout

scene = orbisim.load_scene("suite:pendulum-swingup")
backend = orbisim.make_backend("learned", scene)  # of the zoo; any differentiable backend will do
start = backend.reset()
controls = torch.zeros(1, 20, scene.model.nu, requires_grad=True)
optimizer = torch.optim.Adam([controls], lr=0.05)

for iteration in range(15):
    path = rollout(backend, start, torch.tanh(controls))
    loss = (path[-1].qpos[0, 0] - (float(start.qpos[0, 0]) + 0.2)).square()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    if iteration % 5 == 0:
        print(f"{iteration:2} squared distance to the goal {loss.item():.5f} rad^2")
print(f"   squared distance to the goal {loss.item():.5f} rad^2")
