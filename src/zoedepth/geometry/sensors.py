"""Sizes of the sensors of some cameras.

Most cameras say how long a lens would be on 35-mm film, or how many pixels their sensor has per millimetre. For those
whose photos say neither, and for photos from which a program has taken it, this table knows the common ones with one
sensor. Sizes are those that the makers give, to a percent: models are listed with the format of their sensor.
"""

import re

_FULL_FRAME = (35.9, 23.9)
_APS_C = (23.5, 15.6)
_APS_C_OF_CANON = (22.3, 14.9)
_FOUR_THIRDS = (17.3, 13.0)
_ONE_INCH = (13.2, 8.8)
_ONE_BY_2_3_INCH = (6.17, 4.55)

# Format -> maker, the first word that EXIF calls it by -> models, as EXIF calls them behind the maker's name.
_MODELS: dict[tuple[float, float], dict[str, str]] = {
    _FULL_FRAME: {
        "canon": "eos 5d, eos 5d mark ii, eos 5d mark iii, eos 5d mark iv, eos 6d, eos 6d mark ii, eos-1ds mark ii, "
        "eos-1ds mark iii, eos-1d x, eos r, eos rp, eos r5, eos r6",
        "dji": "zenmusep1",
        "nikon": "d3, d3s, d3x, d4, d4s, d5, d600, d610, d700, d750, d780, d800, d800e, d810, d850, df, z 5, z 6, z 7",
        "ricoh": "pentax k-1, pentax k-1 mark ii",
        "sony": "dslr-a850, dslr-a900, slt-a99v, ilce-7, ilce-7m2, ilce-7m3, ilce-7m4, ilce-7r, ilce-7rm2, "
        "ilce-7rm3, ilce-7s, ilce-7sm2, dsc-rx1, dsc-rx1r",
    },
    _APS_C: {
        "dji": "fc6540",
        "fujifilm": "x-pro1, x-pro2, x-e1, x-e2, x-e3, x-m1, x-t1, x-t10, x-t2, x-t20, x-t3, x-t30, x-h1, x100, "
        "x100s, x100t, x100f, x100v, finepix x100",
        "nikon": "d1x, d2x, d40, d40x, d50, d60, d70, d70s, d80, d90, d100, d200, d300, d300s, d500, d3000, d3300, "
        "d3400, d3500, d5000, d5100, d5200, d5300, d5500, d5600, d7000, d7100, d7200, d7500, z 50",
        "pentax": "k10d, k20d, k100d, k200d, k-3, k-5, k-5 ii, k-5 ii s, k-7, k-x, k-r, k-m, k-30, k-50, k-01",
        "ricoh": "pentax k-3, pentax k-3 ii, pentax k-50, pentax k-70, gr, gr ii, gr iii",
        "sony": "dslr-a100, dslr-a200, dslr-a300, dslr-a350, dslr-a500, dslr-a550, dslr-a700, slt-a33, slt-a55v, "
        "slt-a65v, slt-a77v, nex-3, nex-5, nex-5n, nex-6, nex-7, ilce-5000, ilce-5100, ilce-6000, ilce-6300, "
        "ilce-6400, ilce-6500",
    },
    _APS_C_OF_CANON: {
        "canon": "eos 20d, eos 30d, eos 40d, eos 50d, eos 60d, eos 70d, eos 80d, eos 90d, eos 7d, eos 7d mark ii, "
        "eos m, eos m3, eos m5, eos m50, eos m100, eos r7, eos r10, eos 350d digital, eos 400d digital, eos 450d, "
        "eos 500d, eos 550d, eos 600d, eos 650d, eos 700d, eos 750d, eos 760d, eos 800d, eos 100d, eos 200d, "
        "eos 1000d, eos 1100d, eos 1200d, eos 1300d, eos digital rebel xt, eos digital rebel xti, "
        "eos digital rebel xs, eos digital rebel xsi, eos rebel t1i, eos rebel t2i, eos rebel t3, eos rebel t3i, "
        "eos rebel t4i, eos rebel t5, eos rebel t5i, eos rebel t6, eos rebel t6i, eos rebel sl1",
    },
    _FOUR_THIRDS: {
        "dji": "fc550, fc6520",
        "olympus": "e-1, e-3, e-5, e-30, e-300, e-330, e-400, e-410, e-420, e-450, e-500, e-510, e-520, e-620, e-p1, "
        "e-p2, e-p3, e-p5, e-pl1, e-pl2, e-pl3, e-pl5, e-pl7, e-pl8, e-pm1, e-pm2, e-m1, e-m1markii, e-m5, "
        "e-m5markii, e-m10, e-m10markii, e-m10 mark iii",
        "panasonic": "dmc-g1, dmc-g2, dmc-g3, dmc-g5, dmc-g6, dmc-g7, dmc-gf1, dmc-gf2, dmc-gf3, dmc-gf5, dmc-gf6, "
        "dmc-gf7, dmc-gh3, dmc-gh4, dmc-gm1, dmc-gm5, dmc-gx1, dmc-gx7, dmc-gx8, dmc-gx80, dc-gh5, dc-gx9, dc-g9",
    },
    _ONE_INCH: {
        "canon": "powershot g5 x, powershot g7 x, powershot g7 x mark ii, powershot g9 x",
        "dji": "fc6310, fc6310s, fc6510",
        "hasselblad": "l1d-20c",
        "nikon": "1 j1, 1 j2, 1 j3, 1 j4, 1 j5, 1 v1, 1 v2, 1 v3, 1 s1, 1 s2, 1 aw1",
        "sony": "dsc-rx100, dsc-rx100m2, dsc-rx100m3, dsc-rx100m4, dsc-rx100m5, dsc-rx10, dsc-rx10m2, dsc-rx10m3",
    },
    _ONE_BY_2_3_INCH: {
        "dji": "fc200, fc220, fc300s, fc300x, fc350, fc350z",
    },
}

_SENSORS = {
    (maker, model): size
    for size, makers in _MODELS.items()
    for maker, models in makers.items()
    for model in models.split(", ")
}


def sensor_size(make: str, model: str) -> tuple[float, float] | None:
    """Return the width and the height of a camera's sensor in millimetres; None where the table does not know it.

    Args:
        make: the maker as EXIF names it, e.g. "NIKON CORPORATION".
        model: the model as EXIF names it, with or without the maker's name before it, e.g. "NIKON D90".
    """
    maker = re.findall(r"[a-z0-9]+", make.lower())[:1]
    words = model.lower().split()
    if not maker or not words:
        return None
    return _SENSORS.get((maker[0], " ".join(words[1:] if words[0] == maker[0] else words)))
