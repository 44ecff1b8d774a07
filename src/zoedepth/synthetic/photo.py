"""A camera and its flaws: exposure, white balance, lens, noise, compression."""

import io

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image


def photograph(
    light: Float32[np.ndarray, "height width 3"], rng: np.random.Generator
) -> UInt8[np.ndarray, "height width 3"]:
    """Take an sRGB picture of linear light with a camera drawn from ``rng``."""
    height, width = light.shape[:2]
    brightness = light.mean(-1)
    # The exposure follows the picture's middle brightness, more or less; bright windows and skies burn out.
    grey = np.exp(np.mean(np.log(brightness + 1e-3)))
    grey = 0.7 * grey + 0.3 * np.percentile(brightness[::4, ::4], 80)
    light = light * np.float32(rng.uniform(0.2, 0.42) / max(grey, 1e-4))
    light = light * np.exp(rng.normal(0, (0.09, 0.02, 0.12))).astype(np.float32)
    if rng.random() < 0.7:
        light = _bloom(light, rng.uniform(0.01, 0.06))
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    light = light * (1 - rng.uniform(0, 0.3) * (x * x + y * y) / 2).astype(np.float32)[..., None]
    if rng.random() < 0.5:
        light = _blur(light, rng.uniform(0.05, 0.25))
    shot, read = rng.uniform(0, 0.02), rng.uniform(0, 0.006)
    noise = rng.standard_normal((height, width, 3), dtype=np.float32)
    light = light + noise * np.sqrt(np.clip(light, 0, 1) * np.float32(shot**2) + np.float32(read**2))
    light = np.maximum(light, 0)
    shoulder = rng.uniform(0.0, 0.35)
    light = light * (1 + shoulder * light / 3) / (1 + shoulder * light)
    picture = np.minimum(light, 1) ** np.float32(1 / rng.uniform(1.9, 2.5))
    gray = picture.mean(-1, keepdims=True)
    picture = gray + (picture - gray) * np.float32(rng.uniform(0.65, 1.25))
    contrast = np.float32(rng.uniform(0.9, 1.15))
    picture = (picture - 0.5) * contrast + 0.5
    pixels = (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
    if rng.random() < 0.6:
        quality = int(rng.integers(55, 96))
        with io.BytesIO() as file:
            Image.fromarray(pixels).save(file, "JPEG", quality=quality)
            pixels = np.array(Image.open(file).convert("RGB"))
    return pixels


def _blur(picture: np.ndarray, side: float) -> np.ndarray:
    """Mix each pixel with its four neighbours; ``side`` is the share of each."""
    for axis in (0, 1):
        padded = np.pad(picture, [(1, 1) if k == axis else (0, 0) for k in range(3)], mode="edge")
        before, after = (np.take(padded, range(s, s + picture.shape[axis]), axis) for s in (0, 2))
        picture = picture * np.float32(1 - 2 * side) + (before + after) * np.float32(side)
    return picture


def _bloom(picture: np.ndarray, amount: float) -> np.ndarray:
    """Add a glow around pixels that are nearly white or brighter."""
    height, width = picture.shape[:2]
    bright = np.clip(picture - 0.8, 0, 3)
    small = Image.fromarray((bright.mean(-1) * 80).astype(np.uint8)).resize(
        (width // 16 + 1, height // 16 + 1), Image.Resampling.BOX
    )
    large = np.asarray(small.resize((width, height), Image.Resampling.BICUBIC), np.float32) / 80
    return picture + np.float32(amount) * 4 * large[..., None]
