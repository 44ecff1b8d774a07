"""The table of sensors: found whatever way a camera writes its name, and of shapes that sensors have."""

import pytest

from zoedepth.geometry.sensors import sensor_size


@pytest.mark.parametrize(
    ("make", "model", "size"),
    [
        ("NIKON CORPORATION", "NIKON D90", (23.5, 15.6)),
        ("NIKON CORPORATION", "NIKON D700", (35.9, 23.9)),
        ("NIKON", "NIKON 1 J1", (13.2, 8.8)),
        ("Canon", "Canon EOS 5D Mark II", (35.9, 23.9)),
        ("Canon", "Canon EOS 400D DIGITAL", (22.3, 14.9)),
        ("OLYMPUS IMAGING CORP.  ", "E-PL1           ", (17.3, 13.0)),
        ("RICOH IMAGING COMPANY, LTD.", "PENTAX K-3", (23.5, 15.6)),
        ("SONY", "DSC-RX100M3", (13.2, 8.8)),
        ("DJI", "FC220", (6.17, 4.55)),
    ],
)
def test_names_as_cameras_write_them(make: str, model: str, size: tuple[float, float]) -> None:
    assert sensor_size(make, model) == size


@pytest.mark.parametrize(
    ("make", "model"),
    [
        ("", ""),
        ("", "NIKON D90"),
        ("NIKON CORPORATION", ""),
        ("-", "NIKON D90"),
        ("Canon", "NIKON D90"),
        ("NIKON CORPORATION", "NIKON D9"),
        ("NIKON CORPORATION", "NIKON"),
    ],
)
def test_other_names_are_unknown(make: str, model: str) -> None:
    assert sensor_size(make, model) is None
