import re
from pathlib import Path

from zoedepth.serve.page_files import FOLDER, read_page
from zoedepth.serve.schemas import PredictionQuery


def test_files_are_found_by_their_addresses(tmp_path: Path) -> None:
    (tmp_path / "vendor").mkdir()
    (tmp_path / "index.html").write_text("<!doctype html>")
    (tmp_path / "vendor" / "a.js").write_text("1")
    (tmp_path / "vendor" / "LICENSE").write_text("MIT")
    (tmp_path / "notes.py").write_text("1")
    files = read_page(tmp_path)
    assert {"/", "/index.html", "/vendor/a.js", "/vendor/LICENSE"} <= set(files)
    assert "/notes.py" not in files
    assert files["/"].content == b"<!doctype html>"
    assert files["/vendor/a.js"].media_type == "text/javascript; charset=utf-8"
    assert files["/"].tag != files["/vendor/a.js"].tag


def test_the_page_takes_the_fields_of_view_that_the_service_takes() -> None:
    schema = PredictionQuery.model_json_schema()["properties"]["fov_x"]["anyOf"][0]
    limits = (str(schema["minimum"]), str(schema["maximum"]))
    page, panel = ((FOLDER / name).read_text(encoding="utf-8") for name in ("index.html", "camera-panel.js"))
    found = re.search(r'id="fov"[^>]*min="([\d.]+)"\s+max="([\d.]+)"', page)
    assert found
    assert found.groups() == limits
    found = re.search(r"LEAST = ([\d.]+),\s+MOST = ([\d.]+);", panel)
    assert found
    assert found.groups() == limits


def test_the_page_is_there_and_loads_nothing_from_elsewhere() -> None:
    files = read_page()
    assert files["/"].media_type == "text/html; charset=utf-8"
    left_out = {path.name for path in FOLDER.rglob("*") if path.is_file()} - {path.rpartition("/")[2] for path in files}
    assert left_out == set()
