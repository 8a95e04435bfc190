"""An example of each body: a server of the robot ``wxai`` with the scene ``bin`` answers it.

``ID`` stands for the id of an answer that is there: of a plan, or in the scene of ``place`` of a pick.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["EXAMPLES"]

POST = {"kind": "box", "size": [0.06, 0.06, 0.3]}
HOME = [0.0, 0.95, 1.15, -1.25, 0.0, 0.0]
UNTURNED = [1.0, 0.0, 0.0, 0.0]
NOTHING = {
    "format": "planner-service/memory",
    "version": 1,
    "hash": "9f5a1eb4075e05597ebc2df3c0fa48e3d830c5fe54c0309391699bbd77b0dd43",
    "memory": {"joint_names": [], "motions": [], "grips": []},
}

EXAMPLES: Mapping[str, Mapping[str, Mapping[str, Any]]] = {
    "plans": {
        "between named poses": {
            "scene": "bin",
            "request": {"start": "home", "goals": [{"joints": "ready"}], "seed": 7},
        },
        "to a pose of the tool": {
            "scene": "bin",
            "request": {
                "start": HOME,
                "goals": [
                    {
                        "pose": {"position": [0.3, 0.0, 0.2], "quaternion_wxyz": [0.70710678, 0.0, 0.70710678, 0.0]},
                        "room": {"orientation_tolerance": 0.3, "free_axis": [1.0, 0.0, 0.0]},
                    }
                ],
                "planner": {"name": "rrtconnect", "settings": {"range": 0.7}},
                "timing": {"name": "s-curve"},
                "velocity_scale": 0.5,
                "padding": 0.002,
            },
            "deadline": 10.0,
        },
    },
    "certify": {
        "waypoints": {
            "scene": "bin",
            "waypoints": [[0.0, 0.95, 1.15, 0.8, 0.0, 0.0], [0.3, 0.95, 1.15, 0.8, 0.0, 0.0]],
        },
        "a finished plan": {"plan": "ID"},
    },
    "check": {
        "two configurations and the motion between them": {
            "scene": "bin",
            "states": ["home", "ready"],
            "edges": [["home", "ready"]],
        }
    },
    "pick": {"a block": {"scene": "bin", "q": "home", "target": "blue_block"}},
    "place": {
        "what was picked": {
            "scene": {"after": "ID"},
            "carried": "blue_block",
            "poses": [{"position": [0.2, 0.28, 0.0325], "quaternion_wxyz": UNTURNED}],
            "handling": {"support": "tray"},
        }
    },
    "pick_place": {"a block onto a tray": {"scene": "bin", "target": "blue_block", "onto": "tray"}},
    "solve": {
        "a block is lifted": {
            "scene": "bin",
            "q": "home",
            "name": "lift the block",
            "steps": [
                {"kind": "Connect", "name": "to pregrasp"},
                {"kind": "Approach", "name": "descend"},
                {"kind": "Grasp", "object": "blue_block", "support": "table"},
                {"kind": "Retreat", "name": "lift"},
            ],
        },
        "with a memory, which is empty at first": {
            "scene": "bin",
            "q": "home",
            "steps": [{"kind": "MoveTo", "goal": [{"joints": "ready"}]}],
            "memory": NOTHING,
        },
    },
    "plan_cell": {
        "two arms that meet": {
            "scene": "bin",
            "arms": [
                {
                    "name": "left",
                    "base": {"position": [0.0, 0.0, 0.0], "quaternion_wxyz": UNTURNED},
                    "request": {
                        "start": [1.2, 1.0, 1.0, -0.5, 0.0, 0.0],
                        "goals": [{"pose": {"position": [0.3, 0.0, 0.35], "quaternion_wxyz": UNTURNED}}],
                    },
                },
                {
                    "name": "right",
                    "base": {"position": [0.75, 0.0, 0.0], "quaternion_wxyz": [0.0, 0.0, 0.0, 1.0]},
                    "request": {"start": [1.2, 1.0, 1.0, -0.5, 0.0, 0.0], "goals": [{"joints": "home"}]},
                    "at_tool": {
                        "arm": "left",
                        "pose": {"position": [0.15, 0.0, 0.0], "quaternion_wxyz": [0.0, 0.0, 0.0, 1.0]},
                    },
                },
            ],
            "delay": 0.05,
        }
    },
    "order": {
        "three places": {
            "scene": "bin",
            "q": "home",
            "visits": [
                {"name": "left", "branches": [{"joints": [0.4, 0.95, 1.15, -1.25, 0.0, 0.0]}]},
                {
                    "name": "right",
                    "branches": [{"joints": [-0.4, 0.95, 1.15, -1.25, 0.0, 0.0]}],
                    "then": [{"name": "away", "branches": [{"joints": [-0.5, 0.6, 0.9, -1.25, 0.0, 0.0]}]}],
                    "after": ["left"],
                },
            ],
            "end": "ready",
        }
    },
    "move_linear": {
        "5 cm up": {"scene": "bin", "start": "ready", "goal": [0.0, 0.0, 0.05], "pace": {"max_tool_speed": 0.1}}
    },
    "replan": {
        "to another goal": {"plan": "ID", "at_time": 0.2, "latency": 0.1, "goals": [{"joints": "home"}]},
    },
    "explain": {
        "a pose out of reach": {
            "scene": "bin",
            "request": {
                "start": "home",
                "goals": [{"pose": {"position": [0.9, 0.0, 0.2], "quaternion_wxyz": UNTURNED}}],
            },
            "plans": 10,
            "remedies": 1,
        }
    },
    "roadmaps": {
        "a small one": {"scene": "bin", "planner": {"name": "prm", "settings": {"milestones": 50}}, "seed": 1},
    },
    "put_scene": {
        "a post": {
            "description": "A post in front of the robot",
            "obstacles": [
                {
                    "name": "post",
                    "shape": POST,
                    "pose": {"position": [0.35, 0.0, 0.15], "quaternion_wxyz": UNTURNED},
                }
            ],
        }
    },
    "edit_scene": {
        "move, add and remove": {
            "edits": [
                {"op": "move", "name": "tray", "pose": {"position": [0.2, 0.3, 0.005], "quaternion_wxyz": UNTURNED}},
                {
                    "op": "add",
                    "obstacle": {
                        "name": "post",
                        "shape": POST,
                        "pose": {"position": [0.35, -0.2, 0.15], "quaternion_wxyz": UNTURNED},
                    },
                },
                {"op": "remove", "name": "demo_post"},
            ]
        }
    },
}
"""By the name of the operation, and what each shows."""
