import http.client
import io
import json
import sys
import urllib.parse

import numpy as np
import pytest
import trimesh

from levelflow import EmptyLevelSet, extract
from levelflow.viewer.editing import Editing
from levelflow.viewer.packing import unpack
from levelflow.viewer.server import Server
from levelflow.viewer.viewed import ViewedField
from tests.export.moving import growing, radius


@pytest.fixture(scope="module")
def server():
    server = Server(
        [ViewedField(growing(), name="ball"), ViewedField(growing(space=2), name="disc")], resolution=32, preview=16
    )
    server.start()
    yield server
    server.close()


HANDLES = json.dumps(
    {
        "handles": [
            {"region": {"sphere": {"center": [0, 0, -0.5], "radius": 0.3}}, "freeze": True},
            {"region": {"sphere": {"center": [0, 0, 0.5], "radius": 0.3}}, "move": [0, 0, 0.2]},
        ]
    }
)


@pytest.fixture(scope="module")
def editor(tmp_path_factory):
    """A server of a page that edits handles."""
    still = growing().at(0.0)
    file = tmp_path_factory.mktemp("handles") / "handles.json"
    editing = Editing(extract(still, resolution=24), file, command="levelflow edit ball --handles handles.json")
    server = Server([ViewedField(still, name="ball")], resolution=32, preview=16, editing=editing)
    server.start()
    yield server
    server.close()


def ask(server, path, *, token=None, body=None, **headers):
    """Status, headers and body; with a body the request is one that sends it, as JSON if nothing else is said."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=30)
    method, kind = ("GET", {}) if body is None else ("POST", {"Content-Type": "application/json"})
    headers = kind | {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, f"/{server.token if token is None else token}/{path}", body, headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, answer.headers, body


def test_it_listens_on_this_machine_only(server):
    assert server.socket.getsockname()[0] == "127.0.0.1"
    assert urllib.parse.urlsplit(server.url).hostname == "127.0.0.1" and len(server.token) >= 20


def test_the_page_is_whole(server):
    status, headers, body = ask(server, "")
    text = body.decode()
    assert status == 200 and headers["Content-Type"].startswith("text/html") and "<title>ball · disc" in text
    assert "http://" not in text and "https://" not in text and "@meta@" not in text
    assert "default-src 'none'" in text and "connect-src 'self'" in text
    assert headers["X-Frame-Options"] == "DENY" and headers["Referrer-Policy"] == "no-referrer"


def test_meta_says_what_there_is_to_see(server):
    meta = json.loads(ask(server, "meta")[2])
    assert [one["name"] for one in meta["viewed"]] == ["ball", "disc"]
    ball = meta["viewed"][0]
    assert ball["times"] == [[-4.0, 1.0]] and ball["lower"] == [-1, -1, -1] and ball["scale"] == 1
    assert [quantity["name"] for quantity in ball["quantities"]] == ["curvature", "speed"]
    (times,) = meta["times"]
    assert times[0] == -4 and times[-1] == 1 and np.allclose(np.diff(times), 5 / 48, atol=1e-8)


def test_a_frame_is_the_surface(server):
    status, headers, body = ask(server, "frame?field=0&t=0.5&resolution=24")
    header, arrays = unpack(body)
    assert status == 200 and headers["Cache-Control"] == "no-store" and header["time"] == [0.5]
    assert np.allclose(np.linalg.norm(arrays["position"], axis=1), radius(0.5), atol=2e-3)
    default = unpack(ask(server, "frame?t=0.5")[2])[1]
    assert len(default["position"]) < len(arrays["position"])
    gone = unpack(ask(server, "frame?t=-3")[2])
    assert "no surface at t = -3" in gone[0]["note"] and not gone[1]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_plane_holds_the_values_of_the_field(server, axis):
    n, offset = 5, 0.25
    body = ask(server, f"plane?t=0.5&axis={axis}&offset={offset}&n={n}")[2]
    values = np.frombuffer(body, "<f4").reshape(n, n)
    line = np.linspace(-1, 1, n)
    second, first = np.meshgrid(line, line, indexing="ij")
    assert np.allclose(values, 3 * (np.sqrt(first**2 + second**2 + offset**2) - radius(0.5)), atol=1e-6)


def test_surfaces_leave_as_files(server):
    for kind in ("ply", "stl", "glb"):
        status, _, body = ask(server, f"export?t=0.5&format={kind}")
        mesh = trimesh.load(io.BytesIO(body), file_type=kind, force="mesh")
        assert status == 200 and np.allclose(mesh.bounds, radius(0.5) * np.array([[-1] * 3, [1] * 3]), atol=2e-3)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("frame?t=7", r"at(7): the field was solved for times from -4 to 1"),
        ("frame?t=nan", "the field was solved for times from -4 to 1"),
        ("frame", "this field depends on 1 time(s)"),
        ("frame?t=soon", "frame: field and t must be numbers, such as field=0&t=0.5"),
        ("frame?t=0&field=2", "frame?field=2: there are 2 fields, numbered from 0"),
        ("frame?t=0&resolution=1", "resolution=1: give a whole number from 2 to 1024"),
        ("frame?t=0&rank=9", "rank=9: give a whole number from 0 to 2"),
        ("plane?t=0&n=fine", "n=fine: give a whole number from 2 to 512"),
        ("plane?t=0&offset=x", "plane?offset=x: give a number"),
        ("export?t=0&format=fbx", "export?format=fbx: known are ply, stl, glb, usdc"),
        ("export?t=-3", "the field is positive everywhere"),
        ("export?field=1&t=0&format=stl", "write_stl"),
    ],
)
def test_wrong_questions_are_answered_in_a_sentence(server, path, message):
    status, _, body = ask(server, path)
    assert status == 400 and message in json.loads(body)["error"]


def test_a_missing_extra_is_named_with_its_command(server, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    status, _, body = ask(server, "export?t=0.5&format=usdc")
    assert status == 400 and "pip install 'levelflow[usd]'" in json.loads(body)["error"]


def test_strangers_are_refused(server):
    port = server.server_address[1]
    for headers in ({"Host": f"evil.example:{port}"}, {"Host": "127.0.0.1:1"}, {"Origin": "http://evil.example"}):
        status, _, body = ask(server, "meta", **headers)
        assert status == 403 and "This server" in json.loads(body)["error"]
    assert ask(server, "meta", Host=f"localhost:{port}", Origin=f"http://localhost:{port}")[0] == 200
    for token in ("", "guess", server.token[:-1]):
        status, _, body = ask(server, "meta", token=token)
        assert status == 403 and "The address is not complete" in json.loads(body)["error"]
    status, _, body = ask(server, "../pyproject.toml")
    assert status == 404 and "known are meta, frame, plane, export" in json.loads(body)["error"]


def test_handles_come_back_as_the_surface_that_they_make(editor):
    status, _, body = ask(editor, "deformed?steps=2&way=arap", body=HANDLES)
    header, arrays = unpack(body)
    assert status == 200 and header["note"] == ""
    before = np.stack([arrays[axis] for axis in "xyz"], 1)
    assert np.allclose(np.linalg.norm(before, axis=1), 0.5, atol=5e-3)
    held = arrays["held"]
    assert np.allclose((arrays["position"] - before)[held == 2], [0, 0, 0.2], atol=1e-6)
    assert np.allclose(arrays["position"][held == 1], before[held == 1], atol=1e-6)
    assert set(held) == {0, 1, 2}


def test_handles_are_saved_and_on_the_page_from_then_on(editor):
    meta = json.loads(ask(editor, "meta")[2])
    assert meta["editing"]["handles"] == [] and meta["editing"]["file"] == "handles.json"
    status, _, body = ask(editor, "handles", body=HANDLES)
    assert status == 200 and json.loads(body) == {"saved": str(editor.editing.file)}
    assert json.loads(editor.editing.file.read_text()) == json.loads(HANDLES)
    assert '"freeze":true' in ask(editor, "")[2].decode()
    assert json.loads(ask(editor, "meta")[2])["editing"]["handles"] == json.loads(HANDLES)["handles"]
    editor.editing.file.unlink()


@pytest.mark.parametrize(
    ("path", "body", "status", "message"),
    [
        ("handles", "{}", 400, "handles_in: the text: it has no 'handles'; write it"),
        ("handles", b"\xff", 400, "handles: send handles as text in UTF-8"),
        ("deformed", HANDLES.replace("-0.5", "-5"), 400, "the region of handle 1 holds no vertex of the surface"),
        ("deformed", HANDLES.replace("0.3", "0.9"), 400, "handle 1 and handle 2 both hold"),
        ("deformed?steps=99", HANDLES, 400, "steps=99: give a whole number from 1 to 8"),
        ("deformed?way=wax", HANDLES, 400, "there is no way 'wax'; known are blended, arap, shell"),
        ("frame", HANDLES, 404, "There is nothing to send to 'frame'; with --handles known are handles, deformed"),
    ],
)
def test_wrong_handles_are_answered_in_a_sentence(editor, path, body, status, message):
    found, _, answer = ask(editor, path, body=body)
    assert found == status and message in json.loads(answer)["error"] and not editor.editing.file.exists()


def test_handles_that_cannot_be_written_are_answered(editor, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied", "handles.json")

    monkeypatch.setattr("levelflow.viewer.editing.replace_file", refuse)
    status, _, answer = ask(editor, "handles", body=HANDLES)
    assert status == 400 and "Permission denied: 'handles.json'" in json.loads(answer)["error"]


def test_strangers_write_nothing(editor, server):
    for more in (
        {"Host": "evil.example:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"token": "guess"},
    ):
        status, _, answer = ask(editor, "handles", body=HANDLES, **more)
        assert status == 403 and "error" in json.loads(answer)
    # What a form of another page could send without being asked.
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data"):
        status, _, answer = ask(editor, "handles", body=HANDLES, Content_Type=kind)
        assert status == 415 and "send handles as application/json" in json.loads(answer)["error"]
    for length in ("99999999", "-1", "many"):
        status, _, answer = ask(editor, "handles", body="", Content_Length=length)
        assert status == 413 and "send at most" in json.loads(answer)["error"]
    assert not editor.editing.file.exists()
    status, _, answer = ask(server, "handles", body=HANDLES)
    assert status == 404 and "with --handles" in json.loads(answer)["error"]


def test_a_frame_that_nobody_waits_for_has_no_content(server, monkeypatch):
    from levelflow.viewer.frames import Superseded

    def get(*_, **__):
        raise Superseded

    monkeypatch.setattr(server.frames, "get", get)
    assert ask(server, "frame?t=0")[::2] == (204, b"")


@pytest.mark.parametrize(("error", "said"), [(ConnectionResetError, ""), (KeyError, "KeyError")])
def test_a_browser_that_goes_away_is_no_error(server, capsys, error, said):
    try:
        raise error
    except error:
        server.handle_error(None, ("127.0.0.1", 1))
    found = capsys.readouterr().err
    assert said in found and bool(said) == bool(found)


def test_what_cannot_be_served_is_refused(server):
    ball = ViewedField(growing(), name="ball")
    port = server.server_address[1]
    with pytest.raises(
        OSError, match=rf"Server\(port={port}\): cannot listen there \(Address already in use\); choose"
    ):
        Server([ball], port=port)
    with pytest.raises(OSError, match=r"Server\(port=70000\): cannot listen there"):
        Server([ball], port=70000)
    with pytest.raises(ValueError, match="there is nothing to show; give a field or a mesh"):
        Server([])
    with pytest.raises(ValueError, match=r"give 2 <= preview <= resolution <= 1024"):
        Server([ball], resolution=16, preview=32)


def test_a_field_that_never_has_a_surface_is_refused():
    gone = Server([ViewedField(growing().at(-3.0), name="gone")], resolution=8, preview=8)
    with pytest.raises(EmptyLevelSet, match="view gone: the field has no surface"):
        gone.check_surface()
    gone.server_close()
    here = Server([ViewedField(growing(), name="")], resolution=8, preview=8)
    here.check_surface()
    assert here.frames.size > 0
    here.server_close()
