"""The optimiser of the trainings: Muon for hidden layers' weights, AdamW for the rest."""

import torch
from torch import nn


class Muon:
    """Muon (Jordan, 2024) for hidden layers' weights, as matrices; AdamW for embeddings, norms, biases, last layers.

    Its updates keep the scale of weights without normalisation layers.
    """

    def __init__(self, network: nn.Module, rate: float, weight_decay: float, last: tuple[str, ...]) -> None:
        """Create both optimisers; matrices share the memory of convolutions, which must be channels last.

        Args:
            network: to train.
            rate: learning rate.
            weight_decay: of both optimisers.
            last: names of the network's parts that are not hidden layers.
        """
        self._layers, rest = [], []
        for name, weights in network.named_parameters():
            if weights.dim() >= 2 and name.split(".")[0] not in last:
                matrix = nn.Parameter(_as_matrix(weights.data))
                if matrix.data_ptr() != weights.data_ptr():
                    raise ValueError(f"{name}: its matrix is a copy; the network has to lie channels last")
                self._layers.append((weights, matrix))
            else:
                rest.append(weights)
        matrices = [matrix for _, matrix in self._layers]
        self._parts = (
            torch.optim.AdamW(rest, lr=rate, weight_decay=weight_decay, fused=True),
            torch.optim.Muon(matrices, lr=rate, weight_decay=weight_decay, adjust_lr_fn="match_rms_adamw"),
        )

    def step(self, rate: float) -> None:
        """Take one step along the network's gradients.

        Args:
            rate: learning rate.
        """
        for weights, matrix in self._layers:
            matrix.grad = None if weights.grad is None else _as_matrix(weights.grad)
        for part in self._parts:
            for group in part.param_groups:
                group["lr"] = rate
            part.step()


def _as_matrix(weights: torch.Tensor) -> torch.Tensor:
    return weights.permute(0, 2, 3, 1).flatten(1) if weights.dim() == 4 else weights
