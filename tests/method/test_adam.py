"""Adam without torch's optimiser class, which brings the compiler's front end along."""

import subprocess
import sys

import torch

from hoi.adam import Adam


def descended(adam_of, seed: int = 0) -> list[torch.Tensor]:
    """Two leaves after steps of a falling learning rate on a loss that leaves one out at first."""
    draw = torch.Generator().manual_seed(seed)
    leaves = [torch.randn(3, 4, generator=draw, requires_grad=True), torch.randn(5, generator=draw, requires_grad=True)]
    step = adam_of(leaves)
    for number in range(20):
        loss = (leaves[0] ** 2).sum().sin() + ((leaves[1] - 1) ** 4).sum() * (number > 5)
        step(loss if number > 5 else (leaves[0] ** 2).sum().sin(), 0.05 * (1 - number / 40))
    return [leaf.detach() for leaf in leaves]


def test_it_steps_as_torch_does_to_the_bit() -> None:
    def ours(leaves):
        adam = Adam(leaves, 0.05)

        def step(loss, rate):
            adam.learning_rate = rate
            adam.gradients_of(loss)
            adam.step()

        return step

    def torchs(leaves):
        adam = torch.optim.Adam(leaves, lr=0.05, foreach=False)

        def step(loss, rate):
            adam.param_groups[0]["lr"] = rate
            adam.zero_grad()
            loss.backward()
            adam.step()

        return step

    for mine, its in zip(descended(ours), descended(torchs), strict=True):
        assert torch.equal(mine, its)


def test_it_brings_no_compiler() -> None:
    code = (
        "import sys, torch; from hoi.adam import Adam; x = torch.ones(3, requires_grad=True); a = Adam([x], 0.1)\n"
        "a.gradients_of((x**2).sum()); a.step(); assert 'torch._dynamo' not in sys.modules and float(x[0].detach()) < 1"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
