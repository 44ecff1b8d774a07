"""Rooms and streets that are made up and rendered with exact metric depth, for training without a download.

Reading order: ``dataset`` draws a scene, a camera and a photo for each index. ``room`` and ``street`` build scenes out
of ``interior``, ``furniture``, ``fittings``, ``clutter`` and ``lamps``, and of ``building``, ``traffic`` and
``greenery``; ``palette`` draws their materials, ``weather`` their sun and sky. A ``scene`` is a list of unit ``shapes``
placed in metres. ``render`` makes the picture: ``trace`` finds what each ray meets, ``surfaces``, ``textures`` and
``noise`` its colour, ``light`` the light on it. ``pose`` is the camera in the scene, ``photo`` the camera's flaws.
"""

from zoedepth.synthetic.dataset import SyntheticScenes

__all__ = ["SyntheticScenes"]
