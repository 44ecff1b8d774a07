"""The sun and the sky."""

import math

from zoedepth.synthetic.palette import Random
from zoedepth.synthetic.scene import Scene, Sky, Sun


def weather(scene: Scene, rng: Random) -> None:
    """Give a street its sun, sky and haze: sunny, hazy or overcast."""
    towards, elevation = _direction(rng, 0.2, 1.2)
    overcast = rng.random() < 0.35
    bright = rng.uniform(0.8, 1.2)
    if overcast:
        gray = rng.uniform(0.75, 1.05) * bright
        zenith, horizon, clouds = (
            (gray * 0.85, gray * 0.88, gray * 0.93),
            (gray, gray, gray * 1.02),
            rng.uniform(0.7, 1.0),
        )
        if rng.random() < 0.4:
            scene.sun = Sun(towards, (0.7, 0.68, 0.62), 0.12)
    else:
        warm = min(1.0, elevation)
        zenith = (0.22 * bright, 0.42 * bright, 0.85 * bright)
        horizon, clouds = (0.85 * bright, 0.9 * bright, 0.98 * bright), rng.uniform(0, 0.7)
        strength = rng.uniform(1.8, 3.5)
        scene.sun = Sun(
            towards,
            (strength, strength * (0.75 + 0.2 * warm), strength * (0.5 + 0.35 * warm)),
            rng.uniform(0.008, 0.02),
        )
    haze = rng.uniform(120, 500) if rng.random() < 0.3 else rng.uniform(500, 3000)
    scene.sky = Sky(zenith, horizon, (0.25, 0.24, 0.22), clouds, haze, rng.uniform(0, 10))
    scene.ambient = (0.1, 0.105, 0.115)


def daylight(scene: Scene, rng: Random) -> None:
    """Give a room the sky outside, and in most cases a sun that may fall in through its windows."""
    towards, _ = _direction(rng, 0.25, 1.0)
    strength = rng.uniform(1.5, 6.0) if rng.random() < 0.6 else 0.0
    if strength:
        scene.sun = Sun(towards, (strength, strength * 0.93, strength * 0.8), rng.uniform(0.005, 0.02))
    scene.sky = Sky((0.9, 1.0, 1.2), (1.1, 1.1, 1.1), (0.4, 0.4, 0.35), 0, 0, 0)


def _direction(rng: Random, lowest: float, highest: float) -> tuple[tuple[float, float, float], float]:
    """Draw a direction to the sun: (unit vector, elevation in radians between ``lowest`` and ``highest``)."""
    azimuth, elevation = rng.uniform(-math.pi, math.pi), rng.uniform(lowest, highest)
    level = math.cos(elevation)
    return (level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)), elevation
