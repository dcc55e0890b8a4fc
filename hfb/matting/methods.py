"""Choose a matting method by name; only the chosen one is imported."""

from hfb.config import MattingConfig
from hfb.matting.matting_protocol import KnownBackground, Matting


def make_matting(config: MattingConfig, quick: bool = False) -> Matting:
    """Return the matting method that the configuration names.

    Args:
        config: names the method, and the network's file where it needs one.
        quick: a third of our own network's work, for mattes that a fit refines.
    """
    if config.method == "known-background":
        return KnownBackground()
    if config.method == "network":
        from hfb.matting.network import NetworkMatting

        return NetworkMatting(blurred=False, looks=(1.0,)) if quick else NetworkMatting()
    from hfb.matting.user_networks.external import external_matting

    return external_matting(config)
