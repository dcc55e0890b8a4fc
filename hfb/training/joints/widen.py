"""Double the channels of a network without changing its output: `hfb train joints-widen --run small --out wide`.

Every wide channel is a copy of a narrow one, and each outgoing weight is split at random between the copies (Chen et
al. 2016, "Net2Net", section 2.3), so that they diverge during training.
"""

import argparse
from pathlib import Path

import torch

from hfb.evidence.joint_network import SMALL, WIDE, JointNetwork
from hfb.training.flags import folder
from hfb.training.weight_files import read_weights, write_checkpoint


def widened(small: JointNetwork, seed: int) -> JointNetwork:
    """Return a network of the wide widths that computes the same as the small one.

    Args:
        small: of the small widths.
        seed: of the random splits.
    """
    draws = torch.Generator().manual_seed(seed)
    wide = JointNetwork(WIDE)
    narrow, state = small.state_dict(), wide.state_dict()
    for name, values in state.items():
        found = narrow[name]
        if found.dim() and found.shape[0] != values.shape[0]:
            found = found[torch.arange(values.shape[0]) % found.shape[0]]
        if found.dim() > 1 and found.shape[1] != values.shape[1]:
            before = found.shape[1]
            if values.shape[1] != 2 * before:
                raise ValueError(f"{name}: {before} channels do not become {values.shape[1]}")
            found = torch.cat([found, found], 1)
            if name != "name":  # the joints' own vectors are no weights: twins have the same
                share = 0.3 + 0.4 * torch.rand(found.shape[0], before, generator=draws)
                shares = torch.cat([share, 1 - share], 1)
                found = found * shares.reshape(*shares.shape, *[1] * (found.dim() - 2))
        state[name] = found
    wide.load_state_dict(state)
    return wide


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Declare the options.

    Args:
        parser: of the program.
    """
    parser.add_argument("--run", type=folder, required=True, metavar="DIR", help="of hfb train joints --small")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the weights")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of how weights are split [0]")


def run(options: argparse.Namespace) -> None:
    """Read the small network's weights, write the wide one's.

    Args:
        options: the parsed options.
    """
    small = JointNetwork(SMALL)
    small.load_state_dict(read_weights(options.run / "average.pt"))
    options.out.mkdir(parents=True, exist_ok=True)
    write_checkpoint(options.out / "average.pt", widened(small, options.seed).state_dict())
