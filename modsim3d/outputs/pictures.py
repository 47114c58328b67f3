"""Pictures as the content of files, written by imageio."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from PIL.Image import Image


def encoded(picture: Image | ArrayLike, ending: str = ".png", **options: Any) -> bytes:
    """The content of a PNG or JPEG file of a picture without a palette or an array; options are of the format."""
    import imageio.v3 as iio

    content: bytes = iio.imwrite("<bytes>", np.asarray(picture), extension=ending, **options)
    return content
