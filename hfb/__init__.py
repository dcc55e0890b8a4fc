"""Human from Blur: recover how a person moved during one exposure."""

__version__ = "0.1.0"
