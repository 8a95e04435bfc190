"""What a window may send: the messages of the page's own controls, with values that these controls can have."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec
import viser

__all__ = ["MAX_BYTES", "PageMessages"]

MAX_BYTES = 65_536
"""Of a message from a window. The page's own have some hundred bytes; it takes no uploads."""

MAX_NUMBER = 2.0**53
"""Beyond it a browser's numbers are not exact."""

MAX_TEXT = 256
"""Characters of a text: what a name may be is told to who types it."""

MAX_COORDINATE = 1e6
"""Of a size, a place or a turn."""

UNIT = 5e-4
"""How far a quaternion's length may be from 1."""

Real = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]  # refuses NaN, too
Vector = tuple[Real, Real, Real]
Quaternion = tuple[Real, Real, Real, Real]
Name = Annotated[str, msgspec.Meta(max_length=256)]
Index = Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]
Screen = tuple[Real, Real]
Modifier = Annotated[str, msgspec.Meta(max_length=32)]
Pixels = Annotated[int, msgspec.Meta(ge=0, le=100_000)]


class _Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """One message; the classes below repeat the fields that viser gives them."""


class _Camera(_Message, tag="ViewerCameraMessage"):
    wxyz: Quaternion
    position: Vector
    fov: Real
    near: Real
    far: Real
    image_height: Pixels
    image_width: Pixels
    look_at: Vector
    up_direction: Vector


class _Update(_Message, tag="GuiUpdateMessage"):
    uuid: Name
    updates: dict[str, Any]


class _Drag(_Message, tag="TransformControlsUpdateMessage"):
    name: Name
    wxyz: Quaternion
    position: Vector
    owner: Name = ""


class _DragStart(_Message, tag="TransformControlsDragStartMessage"):
    name: Name
    owner: Name = ""


class _DragEnd(_Message, tag="TransformControlsDragEndMessage"):
    name: Name
    owner: Name = ""


class _Click(_Message, tag="SceneNodeClickMessage"):
    name: Name
    instance_index: Index | None
    ray_origin: Vector
    ray_direction: Vector
    screen_pos: Screen
    modifier: Modifier | None
    owner: Name = ""


class _NodeDrag(_Message, tag="SceneNodeDragMessage"):
    phase: Literal["start", "update", "end"]
    name: Name
    instance_index: Index | None
    start_position: Vector
    start_screen_pos: Screen
    end_position: Vector
    end_screen_pos: Screen
    button: Literal["left", "middle", "right"]
    modifier: Modifier | None
    owner: Name = ""


class PageMessages:
    """Tells messages that the page's controls can send from all others.

    Args:
        gui: viser's controls.
    """

    def __init__(self, gui: Any) -> None:
        self._gui = gui
        self._decoder = msgspec.msgpack.Decoder(_Camera | _Update | _Drag | _DragStart | _DragEnd | _Click | _NodeDrag)

    def allowed(self, raw: str | bytes) -> bool:
        """Whether a message is one of them. Never raises."""
        if not isinstance(raw, bytes) or len(raw) > MAX_BYTES:
            return False
        try:
            message = self._decoder.decode(raw)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
            return False
        if isinstance(message, _Update):
            return self._settable(message)
        return not isinstance(message, _Drag) or abs(math.hypot(*message.wxyz) - 1.0) < UNIT

    def _settable(self, message: _Update) -> bool:
        """Whether it gives a control a value that it can have: viser itself would set any attribute to anything."""
        handle = self._gui._gui_input_handle_from_uuid.get(message.uuid)
        if handle is None or message.updates.keys() != {"value"}:
            return False
        value = message.updates["value"]
        if isinstance(handle, (viser.GuiDropdownHandle, viser.GuiButtonGroupHandle)):
            return value in handle.options
        if isinstance(handle, viser.GuiButtonHandle):
            return value is True
        if isinstance(handle, viser.GuiCheckboxHandle):
            return isinstance(value, bool)
        if isinstance(handle, viser.GuiTextHandle):
            return isinstance(value, str) and len(value) <= MAX_TEXT
        if isinstance(handle, viser.GuiVector3Handle):
            return _numbers(value, 3) and all(abs(number) <= MAX_COORDINATE for number in value)
        if isinstance(handle, viser.GuiRgbHandle):
            return _numbers(value, 3) and all(0 <= number <= 255 and number == int(number) for number in value)
        if isinstance(handle, (viser.GuiSliderHandle, viser.GuiNumberHandle)):
            return _is_number(value) and _within(value, handle)
        return False


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= MAX_NUMBER


def _numbers(value: Any, count: int) -> bool:
    return isinstance(value, (list, tuple)) and len(value) == count and all(map(_is_number, value))


def _within(value: float, handle: Any) -> bool:
    low, high = (-math.inf if handle.min is None else handle.min), (math.inf if handle.max is None else handle.max)
    whole = not isinstance(handle.value, int) or value == int(value)
    return low <= value <= high and whole
