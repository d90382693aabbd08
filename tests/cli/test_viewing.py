"""`levelflow view` as a user meets it: the page of a server, a page in a file, and what is answered to wrong use."""

import json
import re
import socket
import threading
import urllib.request
import webbrowser

import numpy as np
import pytest

from levelflow import SIREN, Box, Budget, Placed, Sphere, equations, extract, fit, lift, load, save, solve

pytestmark = pytest.mark.filterwarnings("default")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    ball, budget = Sphere(5.0), Budget(150)
    moved = solve(equations.MeanCurvature(1.0), SIREN(3, 1, width=16, depth=2), at={0.0: ball}, until=1, budget=budget)
    save(moved, folder / "moving.safetensors")
    save(fit(SIREN(3, width=16, depth=2), ball, budget=budget), folder / "still.safetensors")
    extract(ball.distance, box=ball.box.expanded(1.0), resolution=16).write(folder / "ball.ply")
    save(Placed(lift(load(folder / "still.safetensors").field, time=2),
                Box((-6,) * 3, (6,) * 3, ((0, 1), (0, 1)))), folder / "pair.safetensors")  # fmt: skip
    gone = Placed(SIREN(3, 1, width=4, depth=1), Box((-1,) * 3, (1,) * 3, ((0, 1),)))
    gone.field.last.bias.data.fill_(2.0)
    save(gone, folder / "gone.safetensors")
    np.savetxt(folder / "cloud.xyz", np.random.default_rng(0).normal(size=(50, 3)))
    return folder


@pytest.fixture
def here(files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in files.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def test_help_says_what_the_page_can_do(run):
    code, out, _ = run("view", "--help")
    assert code == 0 and "space plays" in out and "--html" in out


def test_the_page_is_served_and_opened_until_interrupted(run, here, monkeypatch):
    seen = []

    def opened(url):
        threads = threading.Thread(target=lambda: seen.append(urllib.request.urlopen(url, timeout=30).read().decode()))
        threads.start()
        return True

    def served(self, *_):
        self.timeout = 0.05
        while not seen:
            self.handle_request()
        raise KeyboardInterrupt

    monkeypatch.setattr(webbrowser, "open", opened)
    monkeypatch.setattr("socketserver.BaseServer.serve_forever", served)
    code, out, _ = run("view", "moving.safetensors", "ball.ply", "sphere", "--resolution", 24, "--preview", 12)
    assert code == 0 and re.search(r"http://127\.0\.0\.1:\d+/[\w-]+/ \(Ctrl-C ends it\)", out)
    assert (
        "<title>moving.safetensors · ball.ply · sphere – levelflow</title>" in seen[0]
        and "error of the speed" in seen[0]
    )


def test_a_machine_without_a_browser_is_told_the_address(run, here, monkeypatch):
    def served(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    monkeypatch.setattr("socketserver.BaseServer.serve_forever", served)
    code, out, err = run("view", "ball.ply")
    assert code == 0 and "127.0.0.1" in out and "no browser was found; open the address above" in err


def test_a_page_is_written_to_a_file(run, here):
    common = ("--html", "out.html", "--resolution", 16)
    code, out, _ = run("view", "moving.safetensors", "ball.ply", "--times", "0:1:3", *common)
    assert code == 0 and re.search(r"out\.html: \d\.\d MB, 3 times; it needs no server and no network", out)
    assert '"times":[[0.0,0.5,1.0]]' in (here / "out.html").read_text("utf-8")
    assert "no motion" in run("view", "still.safetensors", *common)[1]
    assert "25 times" in run("view", "moving.safetensors", *common)[1]
    code, out, err = run("view", "pair.safetensors", "ball.ply", "--path", "0,0:1,0:1,1", "--times", "0:1:3", *common)
    assert code == 0 and "3 times" in out, err


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (("still.safetensors",), "levelflow edit still.safetensors --handles 'my handles.json' -o still-edit"),
        (("ball.ply",), "levelflow edit ball.ply --handles 'my handles.json' -o ball-edit"),
        (("sphere",), "levelflow edit sphere --handles 'my handles.json' -o sphere-edit"),
        (
            ("moving.safetensors", "--time", "0.5"),
            "levelflow edit moving.safetensors --handles 'my handles.json' --time 0.5 -o moving-edit",
        ),
    ],
)
def test_the_page_edits_handles_and_says_the_command(run, here, arguments, command):
    handle = {"region": {"sphere": {"center": [0, 0, 5], "radius": 1}}, "freeze": True}
    (here / "my handles.json").write_text(json.dumps({"handles": [handle]}))
    common = ("--handles", "my handles.json", "--html", "out.html", "--resolution", 16)
    code, out, err = run("view", *arguments, *common)
    assert code == 0 and "no motion" in out, err
    text = (here / "out.html").read_text("utf-8")
    meta = json.loads(re.search('id="meta">(.*?)</script>', text)[1])
    assert meta["editing"]["command"] == command and meta["editing"]["handles"] == [handle]
    assert meta["viewed"][0]["times"] == []


def test_handles_are_served_with_the_page(run, here, monkeypatch):
    seen = []

    def served(self):
        seen.append(self.editing)
        raise KeyboardInterrupt

    monkeypatch.setattr("socketserver.BaseServer.serve_forever", served)
    code, _, err = run("view", "still.safetensors", "--handles", "new.json", "--no-open")
    assert code == 0, err
    assert seen[0].description()["handles"] == [] and not (here / "new.json").exists()
    assert np.allclose(np.linalg.norm(seen[0].surface.vertices, axis=1), 5, atol=0.3)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("moving.safetensors", "--times", "0"), 2, "name a file with --html as well"),
        (("none.ply",), 2, "there is no file"),
        (("cloud.xyz",), 2, "a point cloud has no surface; fit a field first"),
        (("ball.ply", "--port", "70000"), 2, "--port 70000: give a number from 0 to 65535"),
        (("ball.ply", "--port", "TAKEN"), 1, r"cannot listen there \(Address already in use\); choose another port"),
        (("ball.ply", "--resolution", "1"), 2, "give 2 <= preview <= resolution"),
        (("gone.safetensors", "--no-open", "--preview", "8"), 1, "view gone.safetensors: the field has no surface"),
        (("gone.safetensors", "--html", "a.html", "--resolution", "8"), 1, "no surface at any of the times"),
        (
            ("moving.safetensors", "--html", "a.html", "--times", "2"),
            2,
            r"solved for times from 0 to 1, and none of \[2",
        ),
        (("moving.safetensors", "--html", "a.html", "--times", "soon"), 2, "give numbers"),
        (("ball.ply", "--html", "a.html", "--times", "0"), 2, "nothing of what is given moves; leave --times out"),
        (("pair.safetensors", "--html", "a.html"), 2, r"has 2 parameters, .* show a Walk through them \(--path\)"),
        (("pair.safetensors", "--html", "a.html", "--path", "0:1"), 2, "give two corners or more"),
        (("ball.ply", "--path", "0:1"), 2, "nothing of what is given moves; leave --path out"),
        (("ball.ply", "--time", "0"), 2, "the page in the browser has a slider; name a file with --handles as well"),
        (("ball.ply", "ball.ply", "--handles", "h.json"), 2, "handles are placed on one surface; give one shape"),
        (("ball.ply", "--handles", "h.json", "--time", "0"), 2, "a mesh stands still; leave --time out"),
        (("moving.safetensors", "--handles", "h.json"), 2, "the field moves from t = 0 to 1; say when with --time 0.5"),
        (("ball.ply", "--handles", "none/h.json"), 2, "there is no folder 'none'; make it first"),
        (("ball.ply", "--handles", "cloud.xyz"), 2, "handles_from: 'cloud.xyz' is not valid JSON"),
        (("ball.ply", "--html", "none/a.html"), 2, "there is no folder 'none'; make it first"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_use_is_answered_in_a_sentence(run, unchecked, here, arguments, code, message):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        found, out, err = run("view", *(port if a == "TAKEN" else a for a in arguments))
    assert found == code and re.search(message, err), err
    assert "Traceback" not in out + err and len(err.splitlines()) == 1 and not (here / "a.html").exists()
