"""The first layers of EfficientNets, which stay in float32 whatever the numbers of the others."""

import re
from pathlib import Path
from xml.etree import ElementTree

FIRST_LAYERS = (".*/conv_stem/.*", ".*/blocks[.]0/.*")
"""Patterns of their names in a graph. Their few channels have very different ranges: in 8 bits they alone changed the
depth of zoed-lite by 2 %, and in bfloat16 by 0.5 % in the mean of 18 photos and by 2 % on one."""

_ACTIVATION = ".*/stages/bn1/.*"
"""The activation between the two."""


def keep_in_float32(path: Path) -> None:
    """Mark the first layers of an OpenVINO file, so that its runtime computes them as they are stored.

    The mark is OpenVINO's own ("precise", its ``disable_fp16_compression``), which its Python can read and not set. It
    matters where the others compute in bfloat16.

    Args:
        path: the .xml file, which is changed.
    """
    patterns = [re.compile(pattern) for pattern in (*FIRST_LAYERS, _ACTIVATION)]
    tree = ElementTree.parse(path)  # just written by OpenVINO, so nothing from outside
    for layer in tree.getroot().iter("layer"):
        if layer.get("type") == "Const" or not any(pattern.match(layer.get("name", "")) for pattern in patterns):
            continue
        info = layer.find("rt_info")
        if info is None:
            info = ElementTree.Element("rt_info")
            layer.insert(0 if layer.find("data") is None else 1, info)
        ElementTree.SubElement(info, "attribute", name="precise", version="0")
    tree.write(path, encoding="utf-8", xml_declaration=True)
