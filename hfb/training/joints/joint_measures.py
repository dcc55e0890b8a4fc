"""Errors of the joint network on held-out images."""

from typing import Any

import numpy as np
import torch

from hfb.evidence.joint_network import JointNetwork
from hfb.training.joints.joint_batches import Bank, as_large


def measure(network: JointNetwork, bank: Bank, most: int = 600) -> dict[str, Any]:
    """Return errors about the pelvis [mm] of start and network, and how often the path's sign is right.

    Args:
        network: set to evaluation.
        bank: held out.
        most: largest number of images.
    """
    network.eval()
    rows: dict[str, list[torch.Tensor]] = {
        "start": [],
        "joints": [],
        "across": [],
        "depth": [],
        "sign": [],
        "still": [],
        "height_cm": [],
    }
    within = []
    for first in range(0, min(len(bank), most), 100):
        chosen = np.arange(first, min(first + 100, len(bank), most))
        pictures = torch.from_numpy(bank.batch(chosen)).float() / 127.5 - 1
        truth, starts = torch.from_numpy(bank.truth[chosen]), torch.from_numpy(bank.starts[chosen, 0])
        starts = as_large(starts, truth[:, 1], torch.zeros(len(starts)))
        mm = 1000 * torch.from_numpy(bank.unit_m[chosen])[:, None]
        with torch.inference_mode():
            claim = network(pictures, starts)
        off = relative(claim.joints) - relative(truth[:, 1])
        rows["start"].append((relative(starts) - relative(truth[:, 1])).norm(dim=-1) * mm)
        rows["joints"].append(off.norm(dim=-1) * mm)
        rows["across"].append(off[..., :2].norm(dim=-1) * mm)
        rows["depth"].append(off[..., 2].abs() * mm)
        path = truth[:, 2] - truth[:, 0]
        forth, back = ((claim.path - sign * path).norm(dim=-1).mean(1) for sign in (1, -1))
        rows["still"].append(torch.minimum(forth, back) / path.norm(dim=-1).mean(1).clamp_min(1e-3))
        far = path.norm(dim=-1).mean(1) > 0.08
        rows["sign"].append(((claim.log_odds > 0) == (forth < back)).float()[far])
        rows["height_cm"].append(100 * (claim.log_height.exp() - torch.from_numpy(bank.height_m[chosen])).abs())
        within.append(((claim.joints - truth[:, 1]).abs() < 0.693 * torch.exp(claim.log_scale)).float().mean((0, 1)))
    figures = {name: round(float(torch.cat(values).mean()), 3) for name, values in rows.items()}
    return figures | {"half_within": [round(float(one), 2) for one in torch.stack(within).mean(0)]}


def relative(joints: torch.Tensor) -> torch.Tensor:
    """Return joints relative to the pelvis.

    Args:
        joints: (N, 24, 3).
    """
    return joints - joints[:, :1]
