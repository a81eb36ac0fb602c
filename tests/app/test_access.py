"""Who is answered, and which files: nobody else, and nothing outside the folder."""

from __future__ import annotations

import html
import http.client
import io
import os
import socket
from urllib.parse import quote

import pytest

from postproc.app import server
from postproc.app.workspace import LARGEST_BYTES, Workspace
from postproc.errors import InputError
from tests.places import ROOT

POCKET = (ROOT / "samples" / "pocket.nc").read_bytes()
REFUSED = 403


def ask(window, method, path, body=None, **changed):
    """Status, headers and content for a request of the window's own page, but for changed headers (None: left out)."""
    host = f"127.0.0.1:{window.access.port}"
    headers = {"Host": host, "Cookie": window.access.cookie.split(";")[0], "Origin": f"http://{host}"}
    headers = {name: value for name, value in (headers | changed).items() if value is not None}
    connection = http.client.HTTPConnection("127.0.0.1", window.access.port, timeout=60)
    connection.putrequest(method, path, skip_host=True)
    if body is not None:
        headers.setdefault("Content-Length", str(len(body)))
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders(body)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), content


def test_the_window_answers_its_own_page(window):
    assert ask(window, "GET", "/")[0] == 200
    assert ask(window, "POST", "/add?name=part.nc", POCKET)[0] == 200
    assert (window.workspace.folder / "part.nc").read_bytes() == POCKET


@pytest.mark.parametrize(
    "path", ["/", "/setup?name=part.nc", "/result?name=part.src", "/run.json?number=0", "/nothing"]
)
@pytest.mark.parametrize(
    "wrong",
    [
        {"Cookie": None},
        {"Cookie": "postproc-1=x"},
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": None},
    ],
)
def test_reading_needs_the_cookie_and_this_machine(window, path, wrong):
    assert ask(window, "GET", path, **wrong)[0] == REFUSED


@pytest.mark.parametrize("path", ["/add?name=part.nc", "/setup?name=part.nc", "/cell", "/place", "/stop", "/convert"])
@pytest.mark.parametrize(
    "wrong",
    [
        {"Origin": None},
        {"Origin": "null"},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1:1"},
        {"Cookie": None},
        {"Host": "evil.example", "Origin": "http://evil.example"},
    ],
)
def test_changes_come_from_the_window_alone(window, path, wrong):
    assert ask(window, "POST", path, POCKET, **wrong)[0] == REFUSED
    assert list(window.workspace.folder.iterdir()) == []


def test_a_token_opens_pages_and_leaves_the_address(window):
    status, headers, _ = ask(window, "GET", f"/?token={window.access.token}", Cookie=None)
    assert (status, headers["Location"]) == (303, "/")
    assert "HttpOnly; SameSite=Strict" in headers["Set-Cookie"]
    assert ask(window, "GET", f"/?token={window.access.token}x", Cookie=None)[0] == REFUSED
    assert ask(window, "POST", f"/cell?token={window.access.token}", b"", Cookie=None)[0] == REFUSED
    status, headers, _ = ask(window, "GET", f"/\\evil.example?token={window.access.token}")
    assert headers["Location"] == "/"


def test_only_this_machine_is_listened_to(window):
    assert window.server_address[0] == "127.0.0.1"
    assert window.socket.family == socket.AF_INET


ELSEWHERE = ("../secret.nc", "..\\secret.nc", "/etc/passwd", "C:\\x.nc", "a.nc:b.nc", "..", "", ".", "link.nc", "-o.nc")
DEVICES = ("con.nc", "\0.nc")


@pytest.mark.parametrize("name", [*ELSEWHERE, *DEVICES])
def test_names_lead_to_nothing_outside(window, tmp_path, name):
    (tmp_path / "secret.nc").write_bytes(POCKET)
    (window.workspace.folder / "link.nc").symlink_to(tmp_path / "secret.nc")
    for path in ("/setup", "/program"):
        assert ask(window, "GET", f"{path}?name={quote(name)}")[0] == 400
    assert ask(window, "POST", f"/add?name={quote(name)}", POCKET)[0] == 400
    assert (tmp_path / "secret.nc").read_bytes() == POCKET
    assert sorted(path.name for path in window.workspace.folder.iterdir()) == ["link.nc"]


def test_results_lead_to_nothing_outside(window, tmp_path):
    results = window.workspace.results
    results.mkdir()
    (tmp_path / "secret.html").write_text("secret")
    (results / "link.html").symlink_to(tmp_path / "secret.html")
    (results / "out").symlink_to(tmp_path)
    (results / "cell.toml").write_text("robot = 1")
    (results / "ok.csv").write_text("1")
    assert ask(window, "GET", "/result?name=ok.csv")[0] == 200
    for name in ("link.html", "out/secret.html", "../../secret.html", "../secret.html", "cell.toml", "a/../ok.csv"):
        assert ask(window, "GET", f"/result?name={quote(name)}")[0] == 400, name


def test_reports_cannot_reach_the_window(window):
    window.workspace.results.mkdir()
    (window.workspace.results / "part.report.html").write_text("<script>1</script>")
    policy = ask(window, "GET", "/result?name=part.report.html")[1]["Content-Security-Policy"]
    assert "sandbox allow-scripts;" in policy
    assert "allow-same-origin" not in policy
    assert "frame-ancestors 'none'" in ask(window, "GET", "/")[1]["Content-Security-Policy"]


@pytest.mark.parametrize("size", [str(LARGEST_BYTES + 1), "-1", "x", "0"])
def test_sizes_that_are_refused(window, size):
    assert ask(window, "POST", "/add?name=part.nc", b"", **{"Content-Length": size})[0] == 400
    assert list(window.workspace.folder.iterdir()) == []


def test_a_file_that_is_there_stays(window):
    (window.workspace.folder / "part.nc").write_bytes(b"G0 X1\n")
    assert ask(window, "POST", "/add?name=part.nc", POCKET)[0] == 400
    assert (window.workspace.folder / "part.nc").read_bytes() == b"G0 X1\n"


def test_a_file_that_breaks_off_is_not_added(tmp_path):
    with pytest.raises(InputError, match="did not come whole"):
        Workspace(tmp_path).add("part.nc", io.BytesIO(POCKET), len(POCKET) + 1)
    assert list(tmp_path.iterdir()) == []


def test_other_kinds_of_files_are_not_added(window):
    for name in ("cell.toml", "numpy.py", "page.html", "part"):
        assert ask(window, "POST", f"/add?name={name}", b"x")[0] == 400


def test_results_of_earlier_inputs_are_not_current(shop):
    """Contents count, never dates: an edited file may be older than its result, and a touched one is the same."""
    workspace = Workspace(shop)
    path = workspace.folder / "part.nc"

    def current():
        return [item.is_current for item in workspace.items()]

    assert current() == [True]
    os.utime(path, (4e9, 4e9))
    assert current() == [True]
    for name in ("part.nc", "corrected/cell.toml", "corrected/part.process.toml", "model/model.toml"):
        edited = workspace.folder / name
        content = edited.read_bytes()
        edited.write_bytes(content + b"\n")
        os.utime(edited, (1e9, 1e9))
        assert current() == [False], name
        edited.write_bytes(content)
    assert current() == [True]


def test_a_cell_that_is_unusable_is_shown_with_its_fault(window):
    window.workspace.results.mkdir()
    window.workspace.cell.write_text('robot = "no_such_robot"\n[base]\nX = 1\n[tool]\nZ = 350\n')
    status, _, page = ask(window, "GET", "/cell")
    assert status == 200
    assert b"no_such_robot" in page
    assert b'name="base.X"' in page


@pytest.mark.parametrize(("method", "path", "handler"), [("GET", "/", "_PAGES"), ("POST", "/stop", "_CHANGES")])
def test_a_fault_of_the_window_has_an_answer_and_a_traceback(
    window, monkeypatch, capsys, tmp_path, method, path, handler
):
    def fail(_):
        raise RuntimeError("<b>out of thoughts</b>")

    monkeypatch.setitem(getattr(server, handler), path, fail)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    status, headers, content = ask(window, method, path, b"" if method == "POST" else None)
    assert (status, headers["Content-Type"]) == (500, "text/html; charset=utf-8")
    text = html.unescape(content.decode())
    (log,) = tmp_path.glob("postproc-fault-*.log")
    assert "a fault of postproc" in text
    assert "try again" in text
    assert str(log) in text
    assert b"<b>out" not in content, "texts of faults are text"
    for traceback in (log.read_text(), capsys.readouterr().err):
        assert "RuntimeError: <b>out of thoughts</b>" in traceback
    assert ask(window, "GET", "/cell")[0] == 200, "the window goes on"


@pytest.mark.parametrize("path", ["//[", "/?" + "&".join(f"a{number}=1" for number in range(40))])
def test_an_address_that_makes_no_sense_has_an_answer(window, path):
    status, _, content = ask(window, "GET", path)
    assert status in (200, 400, 404, 500)
    assert content
