"""Who may use the page and what a window may send: everything else is refused, dropped or slowed down."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import socket
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from planner_service import PlannerService, PlanRequest
from planner_service.view import Viewer, open_viewer
from planner_service.view.serving.client_messages import MAX_BYTES, PageMessages
from planner_service.view.serving.server import MAX_CONNECTIONS, MAX_WINDOWS

PROTOCOL: Any = f"viser-v{viser.__version__}"
SEED = int(os.environ.get("PLANNER_SERVICE_FUZZ_SEED", "24"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the page may write scenes to: one with a link out of it."""
    found = tmp_path_factory.mktemp("around") / "cells"
    found.mkdir()
    (found / "link.toml").symlink_to(found.parent / "outside.toml")
    return found


@pytest.fixture(scope="module")
def viewer(folder: Path) -> Iterator[Viewer]:
    with open_viewer(PlannerService("planar2", "discs"), None, port=0, keep=True, folder=folder) as found:
        yield found


def status(url: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=10) as response:
            return int(response.status)
    except urllib.error.HTTPError as error:
        return error.code


def window(viewer: Viewer, *, url: str | None = None, origin: str | None = None) -> Connection:
    """A window of the page, without a browser."""
    address = (url or viewer.url).replace("http://", "ws://")
    return connect(address, origin=origin, subprotocols=[PROTOCOL], max_size=None, proxy=None)  # type: ignore[arg-type]


def update(handle: Any, value: Any, name: str = "value") -> bytes:
    uuid = handle._impl.uuid
    return msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {name: value}})


CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage",
    "wxyz": (1, 0, 0, 0), "position": (1, 1, 1.5), "fov": 0.7, "near": 0.01, "far": 100,
    "image_height": 500, "image_width": 800, "look_at": (0, 0, 0), "up_direction": (0, 0, 1),
}  # fmt: skip


def reaches_the_page(viewer: Viewer, connection: Connection) -> bool:
    """Whether a joint's slider moved in this window moves the robot."""
    slider = viewer.page._joints[0]
    wanted = 0.5 if abs(viewer.page.state.q[0] - 0.5) > 0.1 else -0.5
    connection.send(msgspec.msgpack.encode(CAMERA))
    end = time.monotonic() + 10.0
    while time.monotonic() < end:
        connection.send(update(slider, wanted))
        time.sleep(0.05)
        if abs(viewer.page.state.q[0] - wanted) < 0.01:
            return True
        slider.value = 0.0
    return False


# Who may use it


def test_the_page_is_served_to_who_knows_its_token(viewer: Viewer) -> None:
    with urllib.request.urlopen(viewer.url) as response:
        assert response.headers["Referrer-Policy"] == "no-referrer"
        assert response.headers["Cache-Control"] == "no-store"
    with window(viewer) as connection:
        assert reaches_the_page(viewer, connection)


def test_nothing_is_answered_without_the_token_which_is_new_with_each_page(viewer: Viewer) -> None:
    origin = viewer.url.rpartition("/")[0]
    with open_viewer(PlannerService("planar2", "discs"), None, port=0) as second:
        other = urlsplit(second.url).path
        assert len(other) == 33
    for path in ("", "/", "/index.html", "/%00", "/\u00e9", other):
        assert status(origin + urllib.request.quote(path, safe="/%")) == 403  # type: ignore[attr-defined]
        with pytest.raises(InvalidHandshake):
            window(viewer, url=origin + path)


def test_other_origins_and_host_names_are_refused_even_with_the_token_and_a_forwarded_port_is_not(
    viewer: Viewer,
) -> None:
    for origin in ("http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1"):
        assert status(viewer.url, Origin=origin) == 403
        with pytest.raises(InvalidHandshake):
            window(viewer, origin=origin)
    assert status(viewer.url, Host="rebound.example") == 403
    assert status(viewer.url, Host="localhost:12345", Origin="http://localhost:12345") == 200
    assert status(viewer.url, Host="[::1]:8080") == 200


def test_a_prompt_does_not_wait_for_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    shown = PlannerService("planar2", "discs").plan(PlanRequest((0.0, 0.0), (0.1, 0.1))).show(port=0)
    assert isinstance(shown, Viewer)
    assert shown.open
    assert shown.url in shown._repr_html_()
    shown.close()


# What a window may send


def test_controls_take_the_values_they_can_have_and_nothing_else_is_set(viewer: Viewer) -> None:
    messages, page = PageMessages(viewer._server.viser.gui), viewer.page
    slider, box, choice, button = page._joints[0], page._show_goal, page._speed, page._play
    good = [(slider, 0.5), (slider, 1), (box, False), (choice, "0.5"), (button, True), (page._controls._seed, 7)]
    assert all(messages.allowed(update(handle, value)) for handle, value in good)
    numbers: list[Any] = [1e9, float("nan"), float("inf"), True, "0.5", None, [0.5], {"a": 1}, 2**63]
    bad = [(slider, value) for value in numbers] + [(box, 1), (choice, "7"), (choice, ["0.5"]), (button, False)]
    bad += [(page._controls._seed, -1), (page._controls._seed, 0.5), (page._status, "text")]
    assert [value for handle, value in bad if messages.allowed(update(handle, value))] == []

    assert not messages.allowed(update(slider, [], "update_cb"))
    assert not messages.allowed(update(slider, True, "removed"))
    both = {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": 0.1, "sync_cb": None}}
    assert not messages.allowed(msgspec.msgpack.encode(both))


def test_handles_go_to_finite_poses_only_and_other_messages_nowhere(viewer: Viewer) -> None:
    messages = PageMessages(viewer._server.viser.gui)
    for kind in ("ShareUrlRequest", "FileTransferStartUpload", "RunJavascriptMessage", "ResetGuiMessage", ""):
        assert not messages.allowed(msgspec.msgpack.encode({"type": kind}))
    pose = {"type": "TransformControlsUpdateMessage", "name": "/aim", "wxyz": (1, 0, 0, 0), "position": (0, 0, 1)}
    assert messages.allowed(msgspec.msgpack.encode(pose))
    for turn in ((0, 0, 0, 0), (2, 0, 0, 0), (0.8, 0, 0, 0), (1.002, 0, 0, 0)):
        assert not messages.allowed(msgspec.msgpack.encode({**pose, "wxyz": turn}))
    for wrong in ({"position": (float("nan"), 0, 0)}, {"position": (0, 0)}, {"owner": 7}):
        assert not messages.allowed(msgspec.msgpack.encode({**pose, **wrong}))


CLICK: dict[str, Any] = {
    "type": "SceneNodeClickMessage", "name": "/scene/cylinder", "instance_index": 0, "ray_origin": (1, 1, 1),
    "ray_direction": (0, 0, -1), "screen_pos": (0.5, 0.5), "modifier": None,
}  # fmt: skip
DRAG: dict[str, Any] = {
    "type": "SceneNodeDragMessage", "phase": "update", "name": "/scene/1/shape", "instance_index": None,
    "start_position": (0, 0, 0), "start_screen_pos": (0.5, 0.5), "end_position": (0.1, 0, 0),
    "end_screen_pos": (0.5, 0.5), "button": "left", "modifier": None,
}  # fmt: skip


def test_clicks_and_drags_have_finite_rays_and_known_words(viewer: Viewer) -> None:
    messages = PageMessages(viewer._server.viser.gui)
    nan, far = float("nan"), 1e9
    known: list[tuple[dict[str, Any], list[dict[str, Any]]]] = [
        (CLICK, [{"ray_direction": (nan, 0, 0)}, {"ray_origin": (far, 0, 0)}, {"instance_index": -1}, {"more": 1}]),
        (DRAG, [{"end_position": (nan, 0, 0)}, {"phase": "never"}, {"button": "fourth"}, {"instance_index": 0.5}]),
    ]
    for good, wrongs in known:
        assert messages.allowed(msgspec.msgpack.encode(good))
        assert [wrong for wrong in wrongs if messages.allowed(msgspec.msgpack.encode({**good, **wrong}))] == []


def test_fields_of_a_cell_take_short_texts_and_finite_numbers(viewer: Viewer) -> None:
    messages, cell = PageMessages(viewer._server.viser.gui), viewer.page._cell
    name, size, colour = cell._name, cell._size, cell._colour
    good = [(name, "<b>crate</b>"), (size, (0.1, 2, 0.3)), (colour, (0, 128, 255))]
    assert all(messages.allowed(update(handle, value)) for handle, value in good)
    bad: list[tuple[Any, Any]] = [(name, "x" * 257), (name, 7), (name, None), (size, (0.1, 0.2)), (size, 0.1)]
    bad += [(size, (0.1, float("nan"), 0.1)), (size, (1e7, 0.1, 0.1)), (size, (True, 0.1, 0.1))]
    bad += [(colour, (0, 0, 256)), (colour, (0.5, 0, 0)), (colour, "#ffffff")]
    assert [value for handle, value in bad if messages.allowed(update(handle, value))] == []


def test_a_window_saves_a_scene_in_the_folder_alone_and_through_no_link(viewer: Viewer, folder: Path) -> None:
    name, save = viewer.page._files._name, viewer.page._files._save
    before = set(folder.parent.rglob("*"))
    with window(viewer) as connection:
        assert reaches_the_page(viewer, connection)
        for wish in ("../outside", "/tmp/outside", "link", "a/b", "..", "", "x\0y", "nul\ntoml"):
            connection.send(update(name, wish))
            connection.send(update(save, True))
            wait_for(lambda: "not saved" in viewer.page._cell.note.content)
            viewer.page._cell.note.content = ""
        assert set(folder.parent.rglob("*")) == before
        connection.send(update(name, "mine"))
        connection.send(update(save, True))
        wait_for((folder / "mine.toml").exists)


def test_a_giant_message_ends_its_window_alone(viewer: Viewer) -> None:
    with window(viewer) as bystander, window(viewer) as attacker:
        attacker.send(bytes(MAX_BYTES + 1))
        with pytest.raises(ConnectionClosed):
            read_to_the_end(attacker)
        assert reaches_the_page(viewer, bystander)


def read_to_the_end(connection: Connection) -> None:
    while True:
        connection.recv(timeout=10)


def test_windows_and_connections_are_limited(viewer: Viewer) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(MAX_WINDOWS):
            stack.enter_context(window(viewer))
        with pytest.raises(InvalidHandshake, match="503"):
            window(viewer)
    host, port = present_address(viewer)
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.create_connection((host, port))) for _ in range(MAX_CONNECTIONS + 20)]
        sockets[-1].settimeout(10)
        with contextlib.suppress(ConnectionResetError):
            assert sockets[-1].recv(1) == b""
    wait_for_page(viewer)


@pytest.mark.slow
def test_nothing_a_window_sends_stops_the_page(viewer: Viewer, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Thousands of messages, malformed, mutated and well formed, from several windows, some of which read nothing."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    attackers = [threading.Thread(target=attack, args=(viewer, SEED + k)) for k in range(4)]
    for thread in attackers:
        thread.start()
    for thread in attackers:
        thread.join(timeout=60)
        assert not thread.is_alive()
    wait_for_page(viewer)
    with window(viewer) as connection:
        assert reaches_the_page(viewer, connection)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kilobytes
    assert "Traceback" not in "".join(capfd.readouterr())
    assert [path.name for path in folder.parent.iterdir()] == ["cells"]
    assert len(viewer.page.state.cell.before) > 3, "some of it edits the cell"


def attack(viewer: Viewer, seed: int) -> None:
    draw = random.Random(seed)
    gui = viewer._server.viser.gui
    uuids = [*gui._gui_input_handle_from_uuid, *gui._container_handle_from_uuid, "", "x" * 1000]
    kinds = [*viser._messages.Message._subclass_from_type_string(), "?"]
    texts = ["box", "add", "<img src=x onerror=alert(1)>", "../../x", "link", "#ffffff", "x" * 256]
    vectors = [(0.1, 0.1, 0.1), (1e6, -1e6, 0.0), (0, 0, 0), (1e-300, 1.0, 1.0), (255, 0, 0)]
    values: list[Any] = [
        *texts,
        *vectors,
        0,
        1,
        -1,
        0.5,
        True,
        None,
        "",
        "a",
        "1",
        float("nan"),
        1e308,
        2**63,
        [],
        [[]],
        {},
        b"\xff",
    ]
    for _ in range(3):
        with window(viewer) as connection, contextlib.suppress(ConnectionClosed):
            connection.send(msgspec.msgpack.encode(CAMERA))
            for _ in range(200):
                choice = draw.random()
                if choice < 0.4:
                    name = draw.choice(["value", "value", "update_cb", "props", "removed", "__class__"])
                    message: Any = {"type": "GuiUpdateMessage", "uuid": draw.choice(uuids)}
                    message["updates"] = {name: draw.choice(values)}
                elif choice < 0.6:  # what some control can have
                    handle = draw.choice(list(gui._gui_input_handle_from_uuid.values()))
                    fitting = list(getattr(handle, "options", ())) or [True, *texts, *vectors, 0.05]
                    message = {"type": "GuiUpdateMessage", "uuid": handle._impl.uuid}
                    message["updates"] = {"value": draw.choice(fitting)}
                elif choice < 0.8:
                    fields = ["uuid", "name", "wxyz", "position", "owner", "part_count", "transfer_uuid", "updates"]
                    message = {key: draw.choice(values) for key in draw.sample(fields, 3)}
                    message["type"] = draw.choice(kinds)
                else:
                    known = draw.choice([CAMERA, CLICK, DRAG])
                    keep = draw.choice([1, 9])  # of a value as it should be
                    message = {
                        key: draw.choice([*[value] * keep * len(values), *values]) for key, value in known.items()
                    }
                raw = bytearray(msgspec.msgpack.encode(message))
                if draw.random() < 0.3:
                    raw[draw.randrange(len(raw))] ^= 1 << draw.randrange(8)
                if draw.random() < 0.1:
                    raw = raw[: draw.randrange(len(raw))]
                connection.send(b"\x91" * 60_000 if draw.random() < 0.01 else bytes(raw))
                if draw.random() < 0.01:
                    connection.send("text")


def present_address(viewer: Viewer) -> tuple[str, int]:
    parts = urlsplit(viewer.url)
    assert parts.hostname is not None
    assert parts.port is not None
    return parts.hostname, parts.port


def wait_for_page(viewer: Viewer) -> None:
    """Wait until the page answers, which it does once the connections of a test are gone."""

    def answers() -> bool:
        with contextlib.suppress(OSError):
            return status(viewer.url) == 200
        return False

    wait_for(answers)


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 10.0
    while not holds():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)
