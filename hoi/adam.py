"""Adam, as `torch.optim.Adam` computes it (Kingma & Ba 2015): the class imports the front end of torch's compiler for
it, over a second of every run, its functional form does not."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.optim.adam import adam


class Adam:
    """Descends on leaves, in place, with the default moments (0.9, 0.999)."""

    def __init__(self, leaves: Sequence[Tensor], learning_rate: float) -> None:
        self.leaves, self.learning_rate = list(leaves), learning_rate
        self._means = [torch.zeros_like(leaf) for leaf in self.leaves]
        self._squares = [torch.zeros_like(leaf) for leaf in self.leaves]
        self._steps = [torch.tensor(0.0) for _ in self.leaves]

    def gradients_of(self, loss: Tensor) -> None:
        """d loss / d leaf in each leaf's `grad`, nothing of before in it."""
        for leaf in self.leaves:
            leaf.grad = None
        loss.backward()

    @torch.no_grad()
    def step(self) -> None:
        """Against the gradients; a leaf without one stays."""
        rows = [row for row, leaf in enumerate(self.leaves) if leaf.grad is not None]
        leaves, means, squares, steps = (
            [values[row] for row in rows] for values in (self.leaves, self._means, self._squares, self._steps)
        )
        gradients = [leaf.grad for leaf in leaves if leaf.grad is not None]
        adam(leaves, gradients, means, squares, [], steps, foreach=False, amsgrad=False, beta1=0.9, beta2=0.999,
             lr=self.learning_rate, weight_decay=0.0, eps=1e-8, maximize=False)  # fmt: skip
