"""Shape aliases and the table of dimension letters.

======  =====================================================
letter  meaning
======  =====================================================
B       clips (or shape samples)
T       frames: images the camera took
S       sub-frames: instants within one exposure
J       joints (24 in the SMPL layout, the root first)
V       vertices
F       faces (triangles)
H W     rows and columns of an image
K       shape coefficients (betas)
D       degree of the motion polynomials; D+1 coefficients
======  =====================================================

Annotations read ``Float[Tensor, "S V 3"]``: they are checked under pytest (jaxtyping + beartype) and
cost nothing in production.
"""

from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array
from torch import Tensor

__all__ = ["Array", "Bool", "Float", "Int", "Shaped", "Tensor"]
