import pytest
from tests.serve.running import Client, form_of, photo


def test_file_names_are_ignored_and_the_order_does_not_matter(client: Client) -> None:
    answer = client.form("/v1/measure", {"pairs": b"[]", "photo": photo(), "points": b"[]"})
    assert answer.status == 200


@pytest.mark.parametrize(
    ("parts", "named"),
    [
        ({}, "no photo"),
        ({"photo": b""}, "no photo"),
        ({"points": b"[]"}, "no photo"),
        ({"photo": b"x", "path": b"/etc/passwd"}, "'path'"),
        ({"photo": b"x", "": b""}, "''"),
        ({"photo": b"x", "points": b" " * 1_100_000}, "points"),
    ],
)
def test_a_form_with_other_parts_is_invalid(parts: dict[str, bytes], named: str, client: Client) -> None:
    answer = client.form("/v1/measure", parts)
    assert (answer.status, answer.problem) == (422, "invalid-request")
    assert named in answer.json["detail"]


def test_a_part_must_not_come_twice(client: Client) -> None:
    body, kind = form_of({"photo": photo()})
    twice = body.removesuffix(b"--9f3b--\r\n") + body
    answer = client.ask("/v1/depth", twice, headers={"Content-Type": kind})
    assert (answer.status, answer.problem) == (422, "invalid-request")
    assert "twice" in answer.json["detail"]


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda body: body[:-8], "multipart/form-data; boundary=9f3b"),
        (lambda body: b"", "multipart/form-data; boundary=9f3b"),
        (lambda body: body, "multipart/form-data"),
        (lambda body: body, "multipart/form-data; boundary=other"),
        (lambda body: b"x" * 1000, "multipart/form-data; boundary=9f3b"),
        (lambda body: body.replace(b"Content-Disp", b"X: " + b"y" * 9000 + b"\r\nContent-Disp"),
         "multipart/form-data; boundary=9f3b"),
        (lambda body: body, "multipart/form-data; boundary=" + "b" * 300),
    ],
)  # fmt: skip
def test_a_malformed_form_is_told(change, kind: str, client: Client) -> None:
    body, _ = form_of({"photo": photo()})
    answer = client.ask("/v1/depth", change(body), headers={"Content-Type": kind})
    assert answer.status in (400, 422)
    assert answer.problem in ("malformed-body", "invalid-request")


@pytest.mark.parametrize(
    "kind", ["application/json", "text/plain", "application/x-www-form-urlencoded", "multipart/mixed"]
)
def test_other_types_of_bodies_are_not_supported(kind: str, client: Client) -> None:
    answer = client.ask("/v1/depth", photo(), headers={"Content-Type": kind})
    assert (answer.status, answer.problem) == (415, "unsupported-format")
    assert "image/jpeg" in answer.json["detail"]
    assert "With curl that is -H 'Content-Type: image/jpeg'" in answer.json["detail"]


def test_the_type_that_is_said_does_not_matter_for_a_photo(client: Client) -> None:
    assert client.ask("/v1/depth", photo(), headers={"Content-Type": "image/jpeg"}).status == 200
