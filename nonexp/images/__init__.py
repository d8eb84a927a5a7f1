"""Images: what they hold, their files, comparing, merging and denoising them.

=================  ===============================================================================
``image``          a rendered image
``moments``        mean and standard error of passes, and how noisy an image is as a whole
``exr``            EXR files with standard errors and metadata
``png``            pictures to look at
``compare``        how two images differ, and whether that is noise
``merge``          one image of renders with different seeds
``denoise``        an image without most of its noise
=================  ===============================================================================
"""

from .exr import read, write
from .image import Image
from .png import tone_map

__all__ = ["Image", "read", "tone_map", "write"]
