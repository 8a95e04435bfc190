"""A reachability map on the page: a slice of it that a slider moves, in the colours of its verdicts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from planner_service.scene.scene import Scene
from planner_service.view.still.maps import AXES, COLOURS, fullest_level, layer_name, sheets_of
from planner_service.view.updates import update
from planner_service.workspace import ReachabilityMap

__all__ = ["MapLayer"]

Handler = Callable[[Callable[[], Any]], Callable[[Any], None]]

HIDDEN = "hidden"

ELSEWHERE = "not shown: the map is about the scene as it was before it was edited"


class MapLayer:
    """The controls of a map and what they show.

    Args:
        gui: viser's panel.
        scene: viser's scene.
        found: The map, in the frame of the robot's base.
        handler: Makes a handler of a control from what it is to do.
    """

    def __init__(
        self,
        gui: Any,
        scene: Any,
        found: ReachabilityMap,
        handler: Callable[[Callable[[], Any]], Callable[[Any], None]],
    ) -> None:
        self._scene, self._found, self._fits = scene, found, True
        self._nodes = dict[int, Any]()
        self._drawn: tuple[int, int, int] | None = None
        sets = [f"{k + 1}: {_quaternion(each.quaternion)}" for k, each in enumerate(found.orientations)]
        with gui.add_folder("reachability map"):
            self._axis = gui.add_dropdown("slice across", (*AXES, HIDDEN), initial_value=AXES[2])
            self._row = gui.add_slider("voxel", 0, max(found.grid.counts[2] - 1, 1), 1, fullest_level(found, 0))
            self._set = gui.add_dropdown("tool", tuple(sets), visible=len(sets) > 1)
            self._legend = gui.add_html("")
        self._sets = sets
        self._axis.on_update(handler(self._turn))
        self._row.on_update(handler(self._draw))
        self._set.on_update(handler(self._draw))
        self._draw()

    def fit(self, scene: Scene) -> None:
        """Show the map as long as the scene is the one that it is about."""
        fits = scene.hash == self._found.scene
        if fits != self._fits:
            self._fits = fits
            self._draw()

    def _turn(self) -> None:
        """Begin in the middle along another axis."""
        if self._axis.value != HIDDEN:
            count = self._found.grid.counts[AXES.index(self._axis.value)]
            self._row.max = max(count - 1, 1)
            self._row.value = count // 2
        self._draw()

    def _draw(self) -> None:
        shown = self._axis.value != HIDDEN and self._fits
        update(self._row, visible=shown)
        if not shown:
            self._clear()
            update(self._legend, content="" if self._fits else ELSEWHERE)
            return
        axis = AXES.index(self._axis.value)
        row = min(int(self._row.value), self._found.grid.counts[axis] - 1)
        wanted = self._sets.index(self._set.value), axis, row
        if wanted == self._drawn:
            return
        self._clear()
        sheets = sheets_of(self._found, *wanted)
        for kind, sheet in sheets.items():
            front = sheet.faces[: len(sheet.faces) // 2]  # viser draws both sides of one
            self._nodes[kind] = self._scene.add_mesh_simple(
                f"/map/{int(kind)}",
                sheet.vertices.astype(np.float32),
                front.astype(np.uint32),
                color=sheet.colour,
                opacity=sheet.opacity,
                flat_shading=True,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        lines = [f"<b>{layer_name(self._found, axis, row)}</b>"]
        lines += [_entry(*COLOURS[kind][:2]) for kind in sheets]
        update(self._legend, content="<br>".join(lines))
        self._drawn = wanted

    def _clear(self) -> None:
        for node in self._nodes.values():
            node.remove()
        self._nodes.clear()
        self._drawn = None


def _quaternion(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _entry(colour: tuple[int, int, int], meaning: str) -> str:
    look = f"display:inline-block;width:0.8em;height:0.8em;background:rgb{colour}"
    return f'<span style="{look}"></span> {meaning}'
