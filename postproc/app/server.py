"""The server of the window: addresses to screens and commands, for one browser of this machine."""

from __future__ import annotations

import contextlib
import json
import sys
import tomllib
import traceback
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, quote, urlsplit

from postproc.app import screens
from postproc.app.access import Access
from postproc.app.automatic import AutomaticConversion
from postproc.app.models import file_of_name, identify_arguments
from postproc.app.runs import Run, Runs, command_line
from postproc.app.testpart import TestPart
from postproc.app.workspace import MEDIA_TYPES, RESULTS, Workspace
from postproc.dialects import registry
from postproc.errors import InputError, PostprocError
from postproc.files.fault_log import write_fault
from postproc.jobs.cell_edit import (
    choose_start,
    edit,
    fields_of,
    frame_tables,
    missing_frames,
    robot_and_frames_text,
    set_feed_rule,
    set_robot,
    use_model,
)
from postproc.jobs.experiments import model_of, readings_of
from postproc.jobs.file_form import FormField, changes_of_user
from postproc.jobs.guided_start import is_edited, load_answers
from postproc.jobs.process_edit import edit_process, process_tables
from postproc.jobs.program_needs import needs_of
from postproc.jobs.programs import states_forces
from postproc.jobs.setup_form import CHECKED_KEY, setup_form, start_arguments
from postproc.machining.tool_comments import named_text
from postproc.robot import shipped_models

_LARGEST_FORM = 1 << 16
"""Largest size of a form [bytes]: its fields are a few kilobytes, but another program could send any number."""
_PROGRAM_SUFFIXES = (".src", ".mod")
"""Extensions of written programs, with which a program can be compared."""
_MOST_FIELDS = 20
"""Largest number of fields in an address."""
_TIMEOUT_S = 60.0
"""Time [s] after which the connection to a silent browser is closed."""
_WINDOW_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'nonce-{}'; img-src data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; frame-ancestors 'self'"
)
"""A report contains texts of programs: its scripts must not have access to the window or its cookie."""
_NO_TEXTS: Mapping[str, str] = {}


class Window(ThreadingHTTPServer):
    """A window on a folder, on a port of 127.0.0.1.

    :param folder: folder of the programs.
    :param port: 0: a free port.
    """

    daemon_threads = True
    allow_reuse_address = False

    def __init__(self, folder: Path, port: int) -> None:
        """Open the port; parameters as of the class.

        :raises InputError: there is no such folder.
        :raises PostprocError: the port is in use.
        """
        if not folder.is_dir():
            raise InputError("no such folder", file=str(folder), advice="Give the folder of your programs.")
        self.workspace = Workspace(folder.resolve())
        self.runs = Runs(self.workspace.folder)
        self.part = TestPart(self.workspace)
        self.automatic = AutomaticConversion(self.workspace, self.runs)
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as cause:
            problem = f"port {port} of 127.0.0.1 cannot be used ({cause.strerror}). Give another --port."
            raise PostprocError(problem) from cause
        self.access = Access.for_port(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print a fault of a request; a browser that closes the connection is no fault."""
        if not isinstance(sys.exc_info()[1], (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Answers one request; an error becomes a page that says what to do.

    Methods without parameters answer the request for one address, see `_PAGES` and `_CHANGES`.
    """

    server: Window
    timeout = _TIMEOUT_S
    server_version = "postproc"
    sys_version = ""

    def do_GET(self) -> None:
        """Send a page or a result."""
        self._answer(_PAGES, is_change=False)

    def do_POST(self) -> None:
        """Carry out a posted command, and redirect the browser to the page that shows its result."""
        self._answer(_CHANGES, is_change=True)

    @property
    def query(self) -> dict[str, str]:
        """Fields in the address of the request: name → value.

        :raises ValueError: there are too many.
        """
        return dict(parse_qsl(urlsplit(self.path).query, keep_blank_values=True, max_num_fields=_MOST_FIELDS))

    def _answer(self, routes: dict[str, Callable[[_Handler], None]], *, is_change: bool) -> None:
        """Answer a request; if it fails, send a page that says what to do.

        :param routes: address → method that answers it.
        :param is_change: the request may change files.
        :raises OSError: the browser has closed the connection.
        """
        try:
            return self._route(routes, is_change=is_change)
        except (ConnectionError, TimeoutError):  # the browser has closed the connection
            raise
        except PostprocError as cause:
            text, status = str(cause), 400
        except (OSError, ValueError) as cause:
            text, status = f"{cause}. Try again.", 500
        except Exception as cause:
            text, status = _report_fault(cause), 500
        self._close_after_response()
        return self._send_page(screens.message_page("That did not work", text), status)

    def _route(self, routes: dict[str, Callable[[_Handler], None]], *, is_change: bool) -> None:
        """Answer a request by the method for its address; refuse it without access, or if there is no such page.

        A token in the address is moved into a cookie, and the browser redirected to the address without it.

        :param routes: address → method that answers it.
        :param is_change: the request may change files.
        """
        path, token = urlsplit(self.path).path, self.query.get("token", "")
        if reason := self.server.access.refusal(dict(self.headers.items()), is_change=is_change, token=token):
            self._close_after_response()
            return self._send(403, reason.encode(), "text/plain; charset=utf-8")
        if token:  # the address of a page may be copied: the secret goes into a cookie instead
            return self._redirect(path if path in routes else "/", ("Set-Cookie", self.server.access.cookie))
        if path not in routes:
            return self._send_page(screens.message_page("Not found", "There is no such page. Go to the programs."), 404)
        return routes[path](self)

    def _close_after_response(self) -> None:
        """Close the connection after the response: bytes not read yet would be taken for the next request."""
        self.close_connection = True

    def posted_form(self) -> dict[str, str]:
        """Return the fields of a posted form: name → value.

        :raises InputError: the form is too large, or does not state its size.
        """
        size = self._body_size()
        if size > _LARGEST_FORM:
            raise InputError("the form is too large")
        return dict(parse_qsl(self.rfile.read(size).decode(errors="replace"), keep_blank_values=True))

    def _body_size(self) -> int:
        """Return the size of the body of the request [bytes].

        :raises InputError: the request does not state the size.
        """
        text = self.headers.get("Content-Length") or "0"
        if not (text.isascii() and text.isdecimal()) or self.headers.get("Transfer-Encoding"):
            raise InputError("the size of what was sent is not stated")
        return int(text)

    def _send_page(self, page: screens.Page, status: int = 200) -> None:
        """Send a page with an HTTP status; only the script with the nonce of the page may run in it."""
        policy = ("Content-Security-Policy", _WINDOW_POLICY.format(page.nonce))
        self._send(status, page.html, "text/html; charset=utf-8", policy)

    def _redirect(self, path: str, *headers: tuple[str, str]) -> None:
        """Redirect the browser to a page, which it requests by GET (status 303).

        :param path: address of the page.
        :param headers: name and value of further headers.
        """
        self._send(303, b"", "text/plain", ("Location", path), *headers)

    def _send(self, status: int, content: bytes, media_type: str, *headers: tuple[str, str]) -> None:
        """Send a response. Browsers do not store it, and take its type as stated.

        :param status: HTTP status.
        :param media_type: of the content.
        :param headers: name and value of further headers.
        """
        self.send_response(status)
        for name, value in (
            ("Content-Type", media_type),
            ("Content-Length", str(len(content))),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "same-origin"),
            *headers,
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing; the base class would print each request."""

    # pages

    def send_programs(self) -> None:
        """Send the list of programs."""
        workspace, runs = self.server.workspace, self.server.runs
        stamp, items = self._stamp(), workspace.items()
        rows = [
            screens.Row(item, runs.latest_run(item.name), waits_for="" if self._has_forces(item.name) else "what cuts")
            for item in items
        ]
        self._send_page(screens.programs_page(workspace, rows, stamp, is_automatic=self.server.automatic.is_on))

    def _has_forces(self, name: str) -> bool:
        """Return whether the forces of a program are known: by a process file, or by comments in the program."""
        workspace = self.server.workspace
        return workspace.process_file(name) is not None or states_forces(workspace.folder / name)

    def _stamp(self) -> str:
        """Return a text that changes when the content of the list of programs changes.

        It contains the number of commands begun: one may begin, fail and write nothing between two requests.
        """
        server = self.server
        active = "-".join(str(run.number) for run in server.runs.active_runs())
        return f"{server.workspace.stamp()}-{server.automatic.is_on}-{server.runs.count}-{active}"

    def send_programs_state(self) -> None:
        """Send as JSON the stamp of the list of programs, and the progress of each running command."""
        progress_texts = {run.key: run.progress for run in self.server.runs.active_runs()}
        self._send(200, json.dumps({"stamp": self._stamp(), "working": progress_texts}).encode(), "application/json")

    def send_questions(self, texts: dict[str, str] | None = None) -> None:
        """Send the page with the questions about a program; begin to correct it once all posted answers can be used.

        :param texts: posted answers by key of the question; None: the page is opened, with the answers saved earlier.
        :raises InputError: there is no such program.
        """
        workspace, name = self.server.workspace, self.query.get("name", "")
        program = workspace.usable_program(name)
        answers = load_answers(workspace.results / f"{registry.program_name(program)}.answers.toml", program)
        process = workspace.results / f"{registry.program_name(program)}.process.toml"
        needs = needs_of(program)
        is_asked = {"cell": not is_edited(workspace.cell, answers), "process": not is_edited(process, answers)}
        kept_texts = answers.answers | ({CHECKED_KEY: "1"} if "stock" in answers.answers else {})
        form = setup_form(needs, kept_texts if texts is None else texts, **is_asked)
        arguments, fault = start_arguments(program, form), ""
        if texts is not None and form.is_complete and not needs.refusal:
            try:
                return self.begin_command(name, f"Correct {name}", arguments)
            except InputError as cause:
                fault = str(cause)
        cutters = [named_text(number, cutter.text) for number, cutter in needs.cutters.items() if cutter.text]
        kept_cell = "" if is_asked["cell"] else robot_and_frames_text(workspace.cell, needs.tools)
        frames = () if is_asked["cell"] else missing_frames(workspace.cell, needs)
        page = screens.setup_page(
            name,
            facts=cutters,
            refusal=needs.refusal,
            form=form,
            command=command_line(arguments),
            fault=fault,
            is_posted=texts is not None,
            kept_cell=kept_cell,
            frames=frames,
        )
        self._send_page(page)
        return None

    def send_program(self) -> None:
        """Send the page of a program.

        :raises InputError: there is no such program.
        """
        workspace, name = self.server.workspace, self.query.get("name", "")
        workspace.program_file(name)
        item = next((item for item in workspace.items() if item.name == name), None)
        if item is None:
            raise InputError(f"{name} is no program")
        results = list(workspace.results.iterdir()) if workspace.results.is_dir() else []
        # the results of this program come first: False sorts before True
        results.sort(key=lambda path: (path.stem.lower() != registry.program_name(Path(name)).lower(), path.name))
        other_programs = [f"{RESULTS}/{path.name}" for path in results if path.suffix in _PROGRAM_SUFFIXES]
        other_programs += [other_program.name for other_program in workspace.items() if other_program.name != name]
        command = command_line(workspace.conversion_arguments(name))
        run = self.server.runs.latest_run(name)
        self._send_page(screens.program_page(item, workspace, other_programs, run=run, command=command))

    def send_run(self) -> None:
        """Send the page of a command.

        :raises InputError: there is no such command.
        """
        self._send_page(screens.run_page(self.server.runs.run_of_number(self.query.get("number", ""))))

    def send_run_state(self) -> None:
        """Send as JSON the exit code of a command, its output, and its progress.

        :raises InputError: there is no such command.
        """
        run = self.server.runs.run_of_number(self.query.get("number", ""))
        content = {"code": run.code, "text": run.text, "share": run.share, "progress": run.progress}
        self._send(200, json.dumps(content).encode(), "application/json")

    def send_cell(self, fault: str = "", texts: Mapping[str, str] = _NO_TEXTS) -> None:
        """Send the form with the numbers of the cell, or a message if there is no cell yet.

        :param fault: reason why posted numbers were not written; empty: none were refused.
        :param texts: the refused numbers as typed, by name of the field.
        """
        workspace = self.server.workspace
        if not workspace.cell.is_file():
            text = "There is no cell yet: the set-up of the first program asks for robot, base and tool."
            return self._send_page(screens.message_page("Cell", text))
        frames = self._frames()
        fields = fields_of(workspace.existing_cell(), frames)
        page = screens.cell_page(
            workspace, fields, fault=fault, texts=texts, is_saved="saved" in self.query, frames=",".join(frames)
        )
        return self._send_page(page, 400 if fault else 200)

    def send_process(self, fault: str = "", texts: Mapping[str, str] = _NO_TEXTS) -> None:
        """Send the form with tools, material and stock of a program; without a name, the list of programs.

        :param fault: reason why posted values were not written; empty: none were refused.
        :param texts: the refused values as typed, by name of the field.
        :raises InputError: there is no such program, or it cannot be read.
        """
        workspace, name = self.server.workspace, self.query.get("name", "")
        if not name:
            rows = [(item.name, self._process_in_words(item.name)) for item in workspace.items()]
            return self._send_page(screens.processes_page(rows))
        program = workspace.usable_program(name)
        path, needs = workspace.process_to_edit(name), needs_of(program)
        if needs.refusal:
            raise InputError(f"{name} cannot be read: {needs.refusal}")
        tables = process_tables(path, needs)
        page = screens.process_page(
            name, path, workspace, tables, fault=fault, texts=texts, is_saved="saved" in self.query
        )
        return self._send_page(page, 400 if fault else 200)

    def _process_in_words(self, name: str) -> str:
        """Return the source of the forces of a program in words: its process file, its comments, or none yet."""
        path = self.server.workspace.process_file(name)
        if path is not None:
            return f"{RESULTS}/{path.name}"
        has_forces = states_forces(self.server.workspace.program_file(name))
        return "forces in its comments" if has_forces else "not stated yet"

    def send_robots(self) -> None:
        """Send the page of all robot models, or of one, with the readings from which a model can be identified."""
        workspace = self.server.workspace
        self._send_page(screens.robots_page(self.query.get("name", ""), workspace, readings_of(workspace.folder)))

    def send_readings(self) -> None:
        """Send the page of readings: the model identified from them, and the commands that use it.

        :raises InputError: there are no such readings.
        """
        workspace, name = self.server.workspace, self.query.get("name", "")
        self._send_page(screens.readings_page(name, workspace, workspace.readings(name)))

    def send_model_page(self) -> None:
        """Send the report of the model of an experiment, or of the test part without a name.

        :raises InputError: there is no such experiment, or its model has no report.
        """
        path = self.server.workspace.model_page(self._model_folder(self.query.get("name", "")))
        self._send(200, path.read_bytes(), MEDIA_TYPES[".html"], ("Content-Security-Policy", _REPORT_POLICY))

    def _model_folder(self, name: str) -> Path:
        """Return the folder of the model of an experiment; for an empty name, of the model of the test part.

        :param name: path of the experiment in the folder of the window.
        :raises InputError: there is no such experiment.
        """
        workspace = self.server.workspace
        return workspace.model_folder(workspace.readings(name).experiment) if name else self.server.part.model

    def send_testpart(self) -> None:
        """Send the page of the test part."""
        self._send_page(screens.testpart_page(self.server.part))

    def send_testpart_file(self) -> None:
        """Send a file of the test part.

        :raises InputError: there is no such file.
        """
        self._send_file(self.server.part.file(self.query.get("name", "")))

    def send_result(self) -> None:
        """Send a file of the folder of results.

        :raises InputError: there is no such file.
        """
        self._send_file(self.server.workspace.result_file(self.query.get("name", "")))

    def _send_file(self, path: Path) -> None:
        """Send a file of a type in `MEDIA_TYPES`: the browser shows HTML, and saves other files."""
        suffix = path.suffix.lower()
        headers = [("Content-Security-Policy", _REPORT_POLICY)]
        if suffix != ".html":
            headers.append(("Content-Disposition", f"attachment; filename*=UTF-8''{quote(path.name)}"))
        self._send(200, path.read_bytes(), MEDIA_TYPES[suffix], *headers)

    # changes

    def add_program(self) -> None:
        """Save a program that was dropped on the page, and send the address of the next page."""
        workspace, name = self.server.workspace, self.query.get("name", "")

        def next_page() -> str:
            """Return the address of the list of programs if conversion is automatic, else of the set-up."""
            is_automatic = self.server.automatic.is_on and workspace.cell.is_file() and self._has_forces(name)
            return "/" if is_automatic else f"/setup?name={quote(name)}"

        self._add_upload(lambda: workspace.add(name, self.rfile, self._body_size()), next_page)

    def _add_upload(self, add: Callable[[], object], next_page: Callable[[], str]) -> None:
        """Add a file that was dropped on the page; send as JSON the address of the next page, or the fault.

        :param add: function that reads the file and saves it; raises `InputError` if the file is refused.
        :param next_page: function that returns the address, called once the file is saved.
        """
        try:
            add()
        except InputError as cause:
            self._close_after_response()
            return self._send(400, json.dumps({"fault": str(cause)}).encode(), "application/json")
        return self._send(200, json.dumps({"next": next_page()}).encode(), "application/json")

    def submit_answers(self) -> None:
        """Take posted answers of the set-up, see `send_questions`."""
        self.send_questions(screens.posted_answers(self.posted_form()))

    def convert_program(self) -> None:
        """Correct a program again, with the options of the form.

        :raises InputError: there is no such program, or the command cannot begin.
        """
        form = self.posted_form()
        arguments = self.server.workspace.conversion_arguments(self._program_name(form))
        for option in screens.FORM_OPTIONS:
            text = form.get(option.name, "").strip()
            if text and option.kind == "flag":
                arguments.append(option.flags[-1])
            elif text:
                arguments.append(f"{option.flags[-1]}={text}")
        self.begin_command(form["name"], f"Correct {form['name']}", arguments)

    def search_place(self) -> None:
        """Begin to search the best place of the part of a program.

        :raises InputError: there is no such program, or the command cannot begin.
        """
        name = self._program_name(self.posted_form())
        folder = f"{RESULTS}/place-{registry.program_name(Path(name))}"
        self.begin_command(
            name, f"Best place for {name}", self.server.workspace.command_arguments("place", name, output=folder)
        )

    def use_best_place(self) -> None:
        """Write the frames of the best place into the cell, and begin to correct the program again.

        These are `$BASE` and the frames by number that move with it. Nothing is written if the command cannot begin.

        :raises InputError: there is no such program or no best place, or the command cannot begin.
        """
        name = self._program_name(self.posted_form())
        workspace = self.server.workspace
        place = tomllib.loads(workspace.best_place_file(name).read_text(encoding="utf-8"))
        frames = {f"base_data.{number}": frame for number, frame in place.get("base_data", {}).items()}
        tables = {"base": place["base"], **frames}
        # fields of the form of the cell, such as base.X
        texts = {f"{table}.{axis}": str(value) for table, frame in tables.items() for axis, value in frame.items()}
        arguments = workspace.conversion_arguments(name)
        self.begin_command(
            name, f"Correct {name}", arguments, lambda: edit(workspace.existing_cell(), texts, [*frames])
        )

    def set_feed(self) -> None:
        """Write the rule of feeds into the cell, and begin to correct a program again.

        "hold" lowers feeds where the tolerance of the part would be exceeded; "program" keeps the feeds of the program.

        :raises InputError: there is no such program or no cell, or the command cannot begin.
        """
        form, workspace = self.posted_form(), self.server.workspace
        name, rule = self._program_name(form), "hold" if form.get("rule") == "hold" else "program"
        cell = workspace.existing_cell()
        self.begin_command(
            name, f"Correct {name}", workspace.conversion_arguments(name), lambda: set_feed_rule(cell, rule)
        )

    def switch_automatic(self) -> None:
        """Turn the automatic correction of programs on or off."""
        self.server.automatic.switch(is_on=self.posted_form().get("to") == "on")
        self._redirect("/")

    def compare_programs(self) -> None:
        """Begin to compare a program with another program of the folder, or with a written program of its results.

        :raises InputError: there is no such program, or the command cannot begin.
        """
        form = self.posted_form()
        name, other_program = self._program_name(form), form.get("other", "")
        # both raise if there is no such file
        if other_program.startswith(f"{RESULTS}/"):
            self.server.workspace.result_file(other_program.removeprefix(f"{RESULTS}/"))
        else:
            self.server.workspace.program_file(other_program)
        arguments = self.server.workspace.command_arguments("compare", name)
        arguments.insert(2, other_program)  # after "compare" and the first program
        if "--process" in arguments:  # `compare` takes process files by --forces too
            arguments[arguments.index("--process")] = "--forces"
        self.begin_command(name, f"Compare {name}", arguments)

    def identify_model(self) -> None:
        """Begin to identify a model from readings.

        :raises InputError: there are no such readings, or the command cannot begin.
        """
        form, workspace = self.posted_form(), self.server.workspace
        name = form.get("name", "")
        arguments = identify_arguments(workspace, workspace.readings(name), form)
        self.begin_command(f"model {name}", f"Model from {name}", arguments, page=f"/readings?name={quote(name)}")

    def validate_model(self) -> None:
        """Begin to check a model with readings that were not used to identify it.

        :raises InputError: there are no such readings, or the command cannot begin.
        """
        form, workspace = self.posted_form(), self.server.workspace
        name = form.get("name", "")
        entry = workspace.readings(name)
        arguments = ["identify", "validate", workspace.relative_name(workspace.model_folder(entry.experiment))]
        arguments += [workspace.relative_name(file_of_name(entry.files, form.get("readings", "")))]
        arguments += ["--experiment", workspace.relative_name(entry.experiment)]
        self.begin_command(
            f"model {name}", f"Check of the model from {name}", arguments, page=f"/readings?name={quote(name)}"
        )

    def use_identified_model(self) -> None:
        """Write an identified model into the cell as its robot.

        :raises InputError: there is no such model, it was refused, or a command runs.
        """
        workspace, name = self.server.workspace, self.posted_form().get("name", "")
        model = model_of(self._model_folder(name))
        if model is None or model.refused:
            raise InputError(f"{name}: there is no model that may be used", advice="Identify one first.")
        self.server.runs.edit(lambda: use_model(workspace.existing_cell(), model.folder))
        self._redirect(f"/readings?name={quote(name)}" if name else "/testpart")

    def write_part(self) -> None:
        """Begin to write the test part.

        :raises InputError: there is no such process file, or the command cannot begin.
        """
        arguments = self.server.part.write_arguments(self.posted_form())
        self.begin_command("testpart", "Test part", arguments, page="/testpart")

    def add_probed(self) -> None:
        """Save a probing file that was filled in and dropped on the page."""
        self._add_upload(lambda: self.server.part.add_probed(self.rfile, self._body_size()), lambda: "/testpart")

    def identify_part(self) -> None:
        """Begin to identify a model from the test part, or to check the model of the cell by the test part.

        :raises InputError: the command cannot begin.
        """
        compare = bool(self.posted_form().get("compare"))
        title = "Check of the cell's model by the part" if compare else "Model from the test part"
        self.begin_command("testpart", title, self.server.part.identify_arguments(compare=compare), page="/testpart")

    def stop_command(self) -> None:
        """Stop a command, and wait up to 5 s for its end.

        :raises InputError: there is no such command.
        """
        run = self.server.runs.run_of_number(self.posted_form().get("number", ""))
        run.stop()
        run.wait(5.0)
        self._redirect(f"/run?number={run.number}")

    def change_robot(self) -> None:
        """Write the name of a shipped robot into the cell; if a command runs, send the form of the cell with the fault.

        :raises InputError: no shipped robot has that name, or there is no cell.
        """
        name, path = self.posted_form().get("robot", ""), self.server.workspace.existing_cell()
        if name not in shipped_models():
            raise InputError(f"no robot {name!r}", advice="Choose one of the list.")
        try:
            self.server.runs.edit(lambda: set_robot(path, name))
        except InputError as cause:
            return self.send_cell(str(cause))
        return self._redirect("/cell?saved")

    def change_start(self) -> None:
        """Write start joints with the tip above the part into the cell.

        If refused, send the form again with the fault.
        """
        path = self.server.workspace.existing_cell()
        try:
            self.server.runs.edit(lambda: choose_start(path))
        except InputError as cause:
            return self.send_cell(str(cause))
        return self._redirect("/cell?saved")

    def change_cell(self) -> None:
        """Write changed numbers of the form into the cell; if refused, send the form again with the fault."""
        form, path, frames = self.posted_form(), self.server.workspace.existing_cell(), self._frames()
        texts = screens.posted_fields(form, fields_of(path, frames))

        def write() -> None:
            """Write the fields that the user changed; changes of the file since the form was sent stay."""
            edit(path, changes_of_user(fields_of(path, frames), texts, screens.shown_texts(form)), frames)

        try:
            self.server.runs.edit(write)
        except InputError as cause:
            return self.send_cell(str(cause), texts)
        return self._redirect(f"/cell?saved&frames={','.join(frames)}" if frames else "/cell?saved")

    def _frames(self) -> tuple[str, ...]:
        """Return the names of the tables of frames, from the address, that the form of the cell has in addition."""
        return frame_tables(self.query.get("frames", ""))

    def change_process(self) -> None:
        """Write changed tools, material and stock of a program; if refused, send the form again with the fault."""
        workspace, name, form = self.server.workspace, self.query.get("name", ""), self.posted_form()
        path, needs = workspace.process_to_edit(name), needs_of(workspace.usable_program(name))

        def fields() -> list[FormField]:
            """Return the fields of the process file as it is now."""
            return [field for table in process_tables(path, needs) for field in table.fields]

        texts = screens.posted_fields(form, fields())
        try:
            self.server.runs.edit(
                lambda: edit_process(path, needs, changes_of_user(fields(), texts, screens.shown_texts(form)))
            )
        except InputError as cause:
            return self.send_process(str(cause), texts)
        return self._redirect(f"/process?name={quote(name)}&saved")

    def begin_command(
        self,
        key: str,
        title: str,
        arguments: list[str],
        change: Callable[[], object] | None = None,
        page: str = "",
    ) -> None:
        """Begin a command of postproc, and redirect the browser to its page.

        :param key: subject of the command: two commands with one key do not run at the same time.
        :param title: heading of the page.
        :param arguments: words after `postproc`.
        :param change: function that changes a file which commands read, before the command begins; None: no change.
        :param page: address that shows the result; empty: the page of the program.
        :raises InputError: the command cannot begin now, see `Runs.begin`; nothing was changed.
        """
        run: Run = self.server.runs.begin(key, title, arguments, change=change, page=page)
        self._redirect(f"/run?number={run.number}")

    def _program_name(self, form: dict[str, str]) -> str:
        """Return the file name of the program that a form names.

        :raises InputError: there is no such program.
        """
        return self.server.workspace.usable_program(form.get("name", "")).name


def _report_fault(fault: Exception) -> str:
    """Write the traceback of a fault of postproc to stderr and into a file; return the message for the user.

    If the file cannot be written, the message does not name it; a fault of stderr is ignored.
    """
    text = "".join(traceback.format_exception(fault))
    with contextlib.suppress(OSError, ValueError, AttributeError):  # a window without a console has no stderr
        sys.stderr.write(text)
    path = write_fault(text)
    place = f" The traceback is in {path}." if path else ""
    return (
        f"Unexpected {type(fault).__name__}: {fault}. This is a fault of postproc: results that are written are whole. "
        f"Go back and try again; report it with the program and the cell, please.{place}"
    )


_PAGES: dict[str, Callable[[_Handler], None]] = {
    "/": _Handler.send_programs,
    "/programs.json": _Handler.send_programs_state,
    "/setup": _Handler.send_questions,
    "/program": _Handler.send_program,
    "/run": _Handler.send_run,
    "/run.json": _Handler.send_run_state,
    "/cell": _Handler.send_cell,
    "/process": _Handler.send_process,
    "/robots": _Handler.send_robots,
    "/readings": _Handler.send_readings,
    "/model": _Handler.send_model_page,
    "/testpart": _Handler.send_testpart,
    "/testpart-file": _Handler.send_testpart_file,
    "/result": _Handler.send_result,
}
_CHANGES: dict[str, Callable[[_Handler], None]] = {
    "/add": _Handler.add_program,
    "/setup": _Handler.submit_answers,
    "/convert": _Handler.convert_program,
    "/automatic": _Handler.switch_automatic,
    "/place": _Handler.search_place,
    "/take-place": _Handler.use_best_place,
    "/compare": _Handler.compare_programs,
    "/feed": _Handler.set_feed,
    "/identify": _Handler.identify_model,
    "/validate": _Handler.validate_model,
    "/use-model": _Handler.use_identified_model,
    "/testpart": _Handler.write_part,
    "/add-probed": _Handler.add_probed,
    "/identify-part": _Handler.identify_part,
    "/stop": _Handler.stop_command,
    "/cell": _Handler.change_cell,
    "/robot": _Handler.change_robot,
    "/start": _Handler.change_start,
    "/process": _Handler.change_process,
}
