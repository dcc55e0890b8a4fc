"""Choose a matting method by name; only the chosen one is imported."""

from hfb.config import MattingConfig
from hfb.matting.matting_protocol import KnownBackground, Matting


def make_matting(config: MattingConfig) -> Matting:
    """The matting method that the configuration names."""
    if config.method == "known-background":
        return KnownBackground()
    if config.method == "network":
        from hfb.matting.network import NetworkMatting

        return NetworkMatting()
    from hfb.matting.user_networks.external import external_matting

    return external_matting(config)
