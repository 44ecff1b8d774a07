import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest
from tests.browsers import LONGEST, browser, needs_browser

from zoedepth.errors import InputError
from zoedepth.geometry.camera import Camera
from zoedepth.outputs import Maps, Options, write_maps
from zoedepth.outputs.cloud import Cloud, cloud_of
from zoedepth.outputs.html import MAX_FILE, write_page, write_page_of_file, write_page_of_maps
from zoedepth.outputs.ownership import has_own_mark
from zoedepth.outputs.ply import write_ply

SIZE = (12, 16)
DEPTH = np.linspace(2, 3, 12 * 16, dtype=np.float32).reshape(SIZE)
IMAGE = np.random.default_rng(0).integers(0, 256, (*SIZE, 3), dtype=np.uint8)
MAPS = Maps(depth=DEPTH, image=IMAGE, camera=Camera.from_fov(SIZE, horizontal=60))
AROUND = Maps(depth=np.full((10, 20), 2.0, np.float32), image=np.zeros((10, 20, 3), np.uint8), panorama=True)


def facts(page: Path) -> dict[str, str]:
    """Return what the page says of its content."""
    found = re.search(r'<script type="application/json" id="facts">(.*?)</script>', page.read_text(encoding="utf-8"))
    assert found
    return json.loads(found[1])


def content(page: Path) -> bytes:
    """Return the file that the page holds."""
    found = re.search(r'<script type="text/plain" id="content">(.*?)</script>', page.read_text(encoding="utf-8"))
    assert found
    return base64.b64decode(found[1])


def test_a_page_holds_the_surface_of_a_photo(tmp_path: Path) -> None:
    write_maps(tmp_path / "photo.html", MAPS)
    write_maps(tmp_path / "photo.glb", MAPS)
    assert facts(tmp_path / "photo.html") == {"kind": "glb", "up": "y", "place": "photo"}
    assert content(tmp_path / "photo.html") == (tmp_path / "photo.glb").read_bytes()
    assert has_own_mark(tmp_path / "photo.html")


def test_a_page_holds_the_points_of_a_photo_or_some_of_them(tmp_path: Path) -> None:
    page = tmp_path / "photo.html"
    assert write_page_of_maps(page, MAPS, title="photo", cloud=True).facts == {"points": 192}
    write_ply(tmp_path / "photo.ply", cloud_of(MAPS))
    assert facts(page) == {"kind": "ply", "up": "-y", "place": "photo"}
    assert content(page) == (tmp_path / "photo.ply").read_bytes()
    assert write_page_of_maps(page, MAPS, title="photo", cloud=True, most=50).facts == {"points": 50}

    assert b"element vertex 50\n" in content(page)
    few = content(page)
    write_page_of_maps(page, MAPS, title="photo", cloud=True, most=50)
    assert content(page) == few


def test_a_page_longer_than_browsers_take_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoedepth.outputs.html.MAX_FILE", 1000)
    with pytest.raises(InputError, match=r"photo\.html would hold .* take fewer triangles or points"):
        write_page_of_maps(tmp_path / "photo.html", MAPS, title="photo", cloud=True)
    assert not (tmp_path / "photo.html").exists()


def test_a_surface_has_no_more_triangles_than_allowed(tmp_path: Path) -> None:
    pytest.importorskip("fast_simplification")
    written = write_page_of_maps(tmp_path / "photo.html", MAPS, title="photo", most=100)
    assert written.facts == {"triangles": 100}
    write_maps(tmp_path / "other.html", MAPS, Options(max_triangles=100))
    assert content(tmp_path / "other.html") == content(tmp_path / "photo.html")


def test_a_panorama_is_seen_from_inside(tmp_path: Path) -> None:
    for cloud in (False, True):
        write_page_of_maps(tmp_path / "around.html", AROUND, title="around", cloud=cloud)
        assert facts(tmp_path / "around.html")["place"] == "around"


def test_files_of_this_package_say_how_they_are_seen(tmp_path: Path) -> None:
    for name, maps, place in (("photo", MAPS, "photo"), ("around", AROUND, "around")):
        for kind, up in (("glb", "y"), ("ply", "-y"), ("pcd", "-y")):
            file = tmp_path / f"{name}.{kind}"
            write_maps(file, maps)
            write_page_of_file(tmp_path / "page.html", file)
            assert facts(tmp_path / "page.html") == {"kind": kind, "up": up, "place": place}
            assert content(tmp_path / "page.html") == file.read_bytes()
            assert f"<title>{file.name}</title>" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_files_of_others_are_seen_from_outside(tmp_path: Path) -> None:
    file = tmp_path / "bunny.PLY"
    file.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
    write_page_of_file(tmp_path / "page.html", file)
    assert facts(tmp_path / "page.html") == {"kind": "ply", "up": "y", "place": "outside"}
    write_page_of_file(tmp_path / "page.html", file, up="z")
    assert facts(tmp_path / "page.html")["up"] == "z"


def test_what_is_no_mesh_or_cloud_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.html"
    (tmp_path / "photo.glb").write_bytes(b"a photo")
    for name, message in (("photo.glb", "begin"), ("missing.ply", "opened"), ("shape.obj", r"\.glb, \.ply or \.pcd")):
        with pytest.raises(InputError, match=message):
            write_page_of_file(page, tmp_path / name)
    assert MAX_FILE < 400e6  # what browsers read in one piece, in base64
    monkeypatch.setattr("zoedepth.outputs.html.MAX_FILE", 5)
    with pytest.raises(InputError, match="7 bytes"):
        write_page_of_file(page, tmp_path / "photo.glb")
    assert not page.exists()


def test_pages_need_no_network_and_run_nothing_of_what_they_are_given(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    write_page(page, b"</script><script>alert(1)</script>", kind="ply", title="<b>$facts & co</b>", place="outside")
    text = page.read_text(encoding="utf-8")
    assert "alert(1)" not in text
    assert "<title>&lt;b&gt;$facts &amp; co&lt;/b&gt;</title>" in text
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", text)
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)
    assert policy
    assert policy[1].startswith("default-src 'none'")
    assert "http" not in policy[1]
    assert text.count("<script") == text.count("</script>") == 4
    assert "The MIT License" in text  # of three.js


@needs_browser
def test_a_browser_shows_the_page(tmp_path: Path) -> None:
    write_page_of_maps(tmp_path / "page.html", MAPS, title="photo")
    with browser() as opened:
        page = opened.new_page()
        page.goto(f"{(tmp_path / 'page.html').as_uri()}#angle=20")
        page.wait_for_selector("[data-state=ready]", state="attached", timeout=1000 * LONGEST)
        text = page.inner_text("body")
    assert re.search(r"330 triangles; \d\.\d\d m wide, \d\.\d\d m high, 1\.00 m deep", text), text


def test_a_cloud_without_colours_or_normals_makes_a_page(tmp_path: Path) -> None:
    write_ply(tmp_path / "bare.ply", Cloud(np.ones((4, 3), np.float32)))
    write_page_of_file(tmp_path / "page.html", tmp_path / "bare.ply")
    assert facts(tmp_path / "page.html")["kind"] == "ply"


def test_a_title_that_is_no_utf8_is_readable(tmp_path: Path) -> None:
    write_page_of_maps(tmp_path / "page.html", MAPS, title="caf\udce9.jpg")
    assert "<title>caf" in (tmp_path / "page.html").read_text(encoding="utf-8")
