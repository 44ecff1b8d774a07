import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.serve.running import Client, photo, read_maps, running

from zoedepth.batch import Request, predict_photo
from zoedepth.calibration import calibrate, read_calibration, write_calibration
from zoedepth.depth_map import DepthMap
from zoedepth.outputs import Options
from zoedepth.photos import find_photos
from zoedepth.predict import Predictor
from zoedepth.serve.app import create_app
from zoedepth.serve.settings import Settings


class TestDepth:
    @pytest.mark.parametrize(
        "kind", ["depth", "exr", "npz", "ply", "glb", "usdz", "tiff", "pfm", "npy", "preview", "color"]
    )
    def test_the_file_is_that_of_the_command_line_to_the_last_byte(
        self, kind: str, client: Client, predictor: Predictor, tmp_path: Path
    ) -> None:
        (tmp_path / "photo.png").write_bytes(photo())
        (found,) = find_photos([str(tmp_path / "photo.png")], tmp_path / "out").photos
        outcome = predict_photo(found, predictor, Request("tiny", (kind,)))
        answer = client.ask(f"/v1/depth?format={kind}", photo())
        assert answer.status == 200, answer.body
        expected = outcome.files[kind].read_bytes()
        if kind == "npz":  # a zip has the time of day in it
            ours, theirs = np.load(io.BytesIO(answer.body)), np.load(outcome.files[kind])
            assert {name: ours[name].tobytes() for name in ours} == {name: theirs[name].tobytes() for name in theirs}
        else:
            assert answer.body == expected

    def test_json_says_what_the_sidecar_says(self, client: Client, predictor: Predictor, tmp_path: Path) -> None:
        (tmp_path / "photo.png").write_bytes(photo())
        (found,) = find_photos([str(tmp_path / "photo.png")], tmp_path / "out").photos
        sidecar = json.loads(json.dumps(predict_photo(found, predictor, Request("tiny", ())).sidecar))
        told = client.ask("/v1/depth?format=json", photo()).json
        # Of the command line alone: where the files are, how long it took, and what computed it.
        for name in ("source", "files", "seconds", "config_size", "runtime"):
            del sidecar[name]
        assert {name: told[name] for name in sidecar} == sidecar

    def test_maps_can_be_read_without_a_library(self, client: Client, predictor: Predictor) -> None:
        header, arrays = read_maps(client.ask("/v1/depth?format=maps", photo(50, 41)).body)
        expected = predictor(io.BytesIO(photo(50, 41)))
        assert arrays["depth"].tobytes() == expected.depth.tobytes()
        assert expected.std is not None
        assert arrays["std"].tobytes() == expected.std.tobytes()
        assert np.array_equal(arrays["valid"], expected.valid)
        assert header["camera"]["fx"] == expected.camera.fx
        assert header["domain"] == expected.domain

    @pytest.mark.parametrize(
        ("accept", "kind"),
        [
            (None, "image/png"),
            ("*/*", "image/png"),
            ("image/avif,image/webp,*/*;q=0.8", "image/png"),
            ("application/json;q=0.5, model/gltf-binary", "model/gltf-binary"),
            ("application/json", "application/json"),
            ("model/*", "model/gltf-binary"),
            ("image/jpeg", "image/jpeg"),
        ],
    )
    def test_accept_chooses_the_format(self, accept: str | None, kind: str, client: Client) -> None:
        answer = client.ask("/v1/depth", photo(), headers={} if accept is None else {"Accept": accept})
        assert (answer.status, answer.headers["content-type"]) == (200, kind)

    def test_a_format_that_cannot_be_given_is_not_acceptable(self, client: Client) -> None:
        answer = client.ask("/v1/depth", photo(), headers={"Accept": "text/csv, image/png;q=0"})
        assert (answer.status, answer.problem) == (406, "not-acceptable")

    def test_options_are_those_of_the_command_line(self, client: Client, predictor: Predictor, tmp_path: Path) -> None:
        query = "format=png&domain=outdoor&fov_x=50&png_scale=256"
        answer = client.ask(f"/v1/depth?{query}", photo())
        from zoedepth.geometry.lens import Lens

        result = predictor(io.BytesIO(photo()), domain="outdoor", camera=Lens(fov_x=50))
        result.save(tmp_path / "depth.png", scale=256)
        assert answer.body == (tmp_path / "depth.png").read_bytes()

    def test_what_a_number_in_a_file_means_is_told(self, client: Client) -> None:
        clipped = client.ask("/v1/depth?png_scale=1000&calibration_scale=1000", photo())
        assert clipped.headers["zoedepth-notes"].startswith("clipped: too far for the scale of the PNG")
        assert "zoedepth-notes" not in client.ask("/v1/depth?png_scale=256", photo()).headers

    def test_flip_is_averaged_unless_it_is_declined(self, client: Client, predictor: Predictor) -> None:
        _, arrays = read_maps(client.ask("/v1/depth?format=maps&flip=false", photo()).body)
        expected = Predictor(predictor.model, flip_average=False)(io.BytesIO(photo()))
        assert arrays["depth"].tobytes() == expected.depth.tobytes()

    @pytest.mark.parametrize(
        "query",
        ["model=other", "domain=space", "format=gif", "fov_x=180", "fov_x=nan", "focal_px=0", "colour=1",
         "camera=exif&fov_x=50", "intrinsics=1,2,3", "vmin=3&vmax=2", "vmax=inf", "max_triangles=0", "flip=perhaps",
         "focal_correction=yes", "calibration_scale=0", "intrinsics=-1,1,0,0", "focal_px=0.1",
         "intrinsics=3300,3300,1919.5,1439.5"],
    )  # fmt: skip
    def test_what_cannot_be_is_invalid(self, query: str, client: Client) -> None:
        answer = client.ask(f"/v1/depth?{query}", photo())
        assert (answer.status, answer.problem) == (422, "invalid-request")
        assert len(answer.json["detail"]) > 20

    def test_a_form_carries_the_photo_and_a_calibration(
        self, client: Client, predictor: Predictor, tmp_path: Path
    ) -> None:
        result = predictor(io.BytesIO(photo()))
        places = np.argwhere(result.valid)[:3]
        found = calibrate(result.depth, [(x, y, 1.7 * result.depth[y, x]) for y, x in places], camera=result.camera)
        write_calibration(tmp_path / "c.json", found)
        parts = {"photo": photo(), "calibration": (tmp_path / "c.json").read_bytes()}
        header, arrays = read_maps(client.form("/v1/depth?format=maps", parts).body)
        assert arrays["depth"].tobytes() == found.apply(result.depth).tobytes()
        assert header["calibration"]["scale"] == found.scale

    def test_a_factor_alone_puts_the_metres_right(self, client: Client, predictor: Predictor) -> None:
        _, arrays = read_maps(client.ask("/v1/depth?format=maps&calibration_scale=2", photo()).body)
        assert np.array_equal(arrays["depth"], 2 * predictor(io.BytesIO(photo())).depth)

    def test_a_calibration_of_another_camera_is_refused(self, client: Client) -> None:
        readings = json.dumps([[5, 5, 1.0]]).encode()
        made = client.form("/v1/calibrate?fov_x=40", {"photo": photo(), "readings": readings})
        answer = client.form("/v1/depth?fov_x=80", {"photo": photo(), "calibration": made.body})
        assert answer.status == 422
        assert "camera" in answer.json["detail"]

    def test_a_calibration_of_other_weights_is_refused_without_telling_where_the_model_lies(
        self, client: Client, model_file: str
    ) -> None:
        readings = json.dumps([[5, 5, 1.0]]).encode()
        made = client.form("/v1/calibrate", {"photo": photo(), "readings": readings})
        assert made.json["calibration"]["weights"]
        for other in ({"weights": "of yesterday"}, {"weights": None, "network": "elsewhere/other.safetensors"}):
            changed = {**made.json, "calibration": {**made.json["calibration"], **other}}
            answer = client.form("/v1/depth", {"photo": photo(), "calibration": json.dumps(changed).encode()})
            assert answer.status == 422
            assert "it was measured with" in answer.json["detail"]
            assert str(Path(model_file).parent) not in answer.body.decode()

    @pytest.mark.parametrize("calibration", [b"", b"{}", b"[1]", b"\xff", b'{"zoedepth": "calibration"}'])
    def test_what_is_no_calibration_is_invalid(self, calibration: bytes, client: Client) -> None:
        answer = client.form("/v1/depth", {"photo": photo(), "calibration": calibration})
        assert (answer.status, answer.problem) == (422, "invalid-request")

    def test_exif_tells_the_camera_and_is_in_no_answer(self, client: Client) -> None:
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "SECRETMAKER", "SECRETMODEL"
        exif.get_ifd(0x8825)[1], exif.get_ifd(0x8825)[29] = "N", "2024:SECRETDAY"
        exif.get_ifd(0x8769)[0xA405] = 26  # the focal length as on 35-mm film
        exif.get_ifd(0x8769)[0xA431] = "SECRETSERIAL"
        content = photo(64, 48, format="JPEG", exif=exif)
        assert content.count(b"SECRET") >= 3
        told = client.ask("/v1/depth?format=json", content)
        assert told.json["camera"]["source"] == "exif"
        kinds = ("png", "exr", "npz", "ply", "glb", "usdz", "json", "tiff", "pfm", "npy", "pcd", "html", "jpg", "maps")
        for kind in kinds:
            answer = client.ask(f"/v1/depth?format={kind}", content)
            assert answer.status == 200
            assert b"SECRET" not in answer.body

    def test_warnings_about_a_photo_are_told(self, model_file: str) -> None:
        file = io.BytesIO()
        Image.new("RGB", (64, 48), (3, 3, 3)).save(file, "PNG")
        with running(Settings((model_file,))) as client:  # begun in this test, whose warnings pytest keeps apart
            (note,) = client.ask("/v1/depth?format=json", file.getvalue()).json["notes"]
            assert note.startswith("the photo is nearly black")
            assert client.ask("/v1/depth?format=json", photo()).json["notes"] == []


class TestMeasure:
    def test_metres_and_distances_are_those_of_the_depth_map(
        self, client: Client, predictor: Predictor, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        bad_row, bad_column = 7, 11  # the depth of the tiny model may be valid everywhere
        found = DepthMap.valid.fget

        def but_for_one(result: DepthMap) -> np.ndarray:
            valid = found(result).copy()
            valid[bad_row, bad_column] = False
            return valid

        monkeypatch.setattr(DepthMap, "valid", property(but_for_one))
        result = predictor(io.BytesIO(photo()))
        (row, column), (other_row, other_column) = np.argwhere(result.valid)[[3, -3]].tolist()
        parts = {
            "photo": photo(),
            "points": json.dumps([[column, row], [bad_column, bad_row]]).encode(),
            "pairs": json.dumps([[[column, row], [other_column, other_row]]]).encode(),
        }
        told = client.form("/v1/measure", parts).json
        depth, std = result.at(column, row)
        assert told["points"][0] == {"x": column, "y": row, "depth": depth, "std": std, "reason": None}
        assert told["points"][1]["depth"] is None
        assert "no depth to rely on" in told["points"][1]["reason"]
        assert told["pairs"][0]["distance"] == result.measure((column, row), (other_column, other_row))
        assert told["about"]["camera"]["source"] == "assumed"

    @pytest.mark.parametrize("points", [b"[[64, 0]]", b"[[-1, 0]]", b"[[1]]", b"{}", b"[[1, 2, 3]]", b"[[1, NaN]]",
                                        b"[" * 5000, b"[[0,0]," * 1001 + b"[0,0]]", b"\xff\xfe"])  # fmt: skip
    def test_points_that_are_none_are_invalid(self, points: bytes, client: Client) -> None:
        answer = client.form("/v1/measure", {"photo": photo(), "points": points})
        assert (answer.status, answer.problem) == (422, "invalid-request")


class TestCalibrate:
    def test_the_answer_is_the_file_of_the_command_line(
        self, client: Client, predictor: Predictor, tmp_path: Path
    ) -> None:
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0xA405] = 26  # the focal length as on 35-mm film
        content = photo(format="JPEG", exif=exif)
        result = predictor(io.BytesIO(content))
        y, x = np.argwhere(result.valid)[5].tolist()
        readings = json.dumps([[x, y, 2.5]]).encode()
        made = client.form("/v1/calibrate?along_ray=true", {"photo": content, "readings": readings})
        found = calibrate(result.depth, [(x, y, 2.5)], camera=result.camera, valid=result.valid, along_ray=True)
        assert made.json["calibration"]["scale"] == found.scale
        (tmp_path / "c.json").write_bytes(made.body)
        assert made.json["calibration"]["network"] == "tiny.safetensors"  # and not the folder that it lies in
        reasons = read_calibration(tmp_path / "c.json").mismatches(
            camera=None, network="runs/tiny.safetensors", domain=None, focal_corrected=result.focal_correction != 1
        )
        assert reasons == ()  # `zoedepth predict --model runs/tiny.safetensors --calibration c.json`
        again = client.form("/v1/depth?format=json", {"photo": content, "calibration": made.body})
        assert again.json["calibration"]["scale"] == found.scale

    @pytest.mark.parametrize(
        ("along_ray", "part", "values"),
        [("false", "distances", b"[[[5, 5], [50, 40], 2]]"), ("true", "readings", b"[[50, 40, 2]]")],
    )
    def test_distances_and_readings_along_the_ray_need_a_camera(
        self, along_ray: str, part: str, values: bytes, client: Client
    ) -> None:
        parts = {"photo": photo(), part: values}
        answer = client.form(f"/v1/calibrate?along_ray={along_ray}", parts)
        assert answer.status == 422
        assert "field of view" in answer.json["detail"]
        assert client.form(f"/v1/calibrate?along_ray={along_ray}&fov_x=60", parts).status == 200

    def test_without_readings_there_is_nothing_to_calibrate_by(self, client: Client) -> None:
        assert client.form("/v1/calibrate", {"photo": photo()}).status == 422


class TestRest:
    def test_models_are_listed_with_formats_and_limits(self, client: Client) -> None:
        told = client.ask("/v1/models").json
        assert told["default"] == "tiny"
        assert told["models"][0]["domains"] == ["indoor", "outdoor"]
        assert told["limits"]["max_body"] == 2_000_000
        assert "image/jpeg" in told["photo_types"]
        assert {"depth", "maps", "glb"} <= {each["name"] for each in told["formats"]}

    def test_checks_and_numbers(self, client: Client) -> None:
        assert client.ask("/healthz").json == {"status": "ok"}
        assert client.ask("/readyz").json == {"status": "ok"}
        client.ask("/v1/depth", photo())
        text = client.ask("/metrics").body.decode()
        assert 'zoedepth_requests_total{path="/v1/depth",status="200"}' in text
        assert "zoedepth_model_seconds_bucket" in text

    @pytest.mark.parametrize("path", ["/nothing", "/v1", "/v1/depth/", "/docs", "/../pyproject.toml", "/%2e%2e/x"])
    def test_what_is_not_there_is_not_found(self, path: str, client: Client) -> None:
        answer = client.ask(path)
        assert (answer.status, answer.problem) == (404, "not-found")

    def test_a_wrong_method_is_told_with_the_right_ones(self, client: Client) -> None:
        answer = client.ask("/v1/depth")
        assert (answer.status, answer.problem, answer.headers["allow"]) == (405, "wrong-method", "POST")

    def test_the_page_is_served_and_known_by_its_tag(self, client: Client) -> None:
        answer = client.ask("/")
        assert answer.headers["content-type"].startswith("text/html")
        again = client.ask("/", headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status, again.body) == (304, b"")
        assert client.ask("/", method="HEAD").status == 200

    def test_a_fault_is_told_without_its_inside(self, model_file: str, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail(*_: object, **__: object) -> None:
            raise RuntimeError("inside")

        monkeypatch.setattr("zoedepth.serve.app.encode", fail)
        with running(Settings((model_file,))) as client:
            answer = client.ask("/v1/depth", photo())
        assert (answer.status, answer.problem) == (500, "internal-error")
        assert b"inside" not in answer.body

    def test_other_sites_may_call_it_only_if_they_are_allowed(self, model_file: str) -> None:
        site = {"Origin": "https://example.org"}
        with running(Settings((model_file,), origins=("https://example.org",))) as client:
            answer = client.ask("/v1/models", headers=site)
            assert answer.headers["access-control-allow-origin"] == "https://example.org"
            preflight = {**site, "Access-Control-Request-Method": "POST"}
            assert client.ask("/v1/depth", method="OPTIONS", headers=preflight).status == 200
            assert client.ask("/v1/models", headers={"Origin": "https://example.com"}).status == 403
            refusal = client.ask("/v1/depth?domain=space", photo(), headers=site)
            assert (refusal.status, refusal.headers["access-control-allow-origin"]) == (422, "https://example.org")

    def test_two_models_are_told_apart_by_name(self, model_file: str, tmp_path: Path) -> None:
        other = tmp_path / "other.safetensors"
        other.write_bytes(Path(model_file).read_bytes())
        with running(Settings((model_file, str(other)))) as client:
            assert [model["name"] for model in client.ask("/v1/models").json["models"]] == ["tiny", "other"]
            assert client.ask("/v1/depth?format=json&model=other", photo()).json["model"] == "other"
            assert client.ask("/v1/depth?format=json", photo()).json["model"] == "tiny"


def test_models_are_loaded_when_that_is_asked_for(model_file: str) -> None:
    service = create_app(Settings((model_file,)))
    assert not service.is_computing
    service.load()
    assert not service.is_computing


def test_options_have_the_defaults_of_the_command_line() -> None:
    from zoedepth.serve.schemas import DepthQuery

    assert DepthQuery().options() == Options()
