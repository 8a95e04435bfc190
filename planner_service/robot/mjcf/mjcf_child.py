"""A script that compiles an MJCF file with mujoco, in a process of its own, and reports what the robot is made of.

Nothing imports it. Its job has ``file`` and ``looks``: whether to report ``seen``, too, the geoms that collide with
nothing and are not hidden, and ``faces``, the triangles of their meshes. It answers with JSON: ``problem``, or
``name``, ``bodies``, ``joints``, ``geoms``, ``sites`` (body, name, place) of those with a name, ``meshes`` (vertices),
``excludes``, ``follows`` (equalities of joints), ``loops`` (kind and name of other equalities), ``keys``, ``qpos``,
``velocities`` (how many), and ``places`` (of each joint its name, if it has one, and its place in both). Quaternions
are wxyz, angles in rad; bodies, joints, meshes and types are numbers, as mujoco has them.
"""

from __future__ import annotations

import json
from typing import Any

GEOM = ("geom_bodyid", "geom_type", "geom_size", "geom_pos", "geom_quat", "geom_dataid")
HIDDEN = 3
"""Groups of geoms from this on are not shown unless somebody asks for them."""


def answer(job: dict[str, Any], data: bytes) -> bytes:
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_path(job["file"])
    except (ValueError, mujoco.FatalError) as error:
        return json.dumps({"problem": " ".join(str(error).split())[:300]}).encode()
    looks = _looks(mujoco, model) if job.get("looks") else {}
    return json.dumps(_told(mujoco, model) | looks).encode()


def _named(model: Any, kind: str, index: int) -> str:
    return str(getattr(model, kind)(index).name) or f"{kind}_{index}"


def _columns(model: Any, *names: str) -> list[tuple[Any, ...]]:
    return list(zip(*(getattr(model, name).tolist() for name in names), strict=True))


def _colliding(model: Any) -> set[int]:
    """The geoms that collide with anything."""
    ways = enumerate(_columns(model, "geom_contype", "geom_conaffinity"))
    return {k for k, way in ways if any(way)} | {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}


def _looks(mujoco: Any, model: Any) -> dict[str, Any]:
    """What is to be seen of a model and collides with nothing."""
    collides, alphas = _colliding(model), model.mat_rgba[:, 3].tolist()
    seen: list[list[Any]] = []
    faces: list[list[list[int]]] = [[] for _ in range(model.nmesh)]
    starts, counts = model.mesh_faceadr.tolist(), model.mesh_facenum.tolist()
    for k, row in enumerate(_columns(model, *GEOM)):
        alpha = alphas[model.geom_matid[k]] if model.geom_matid[k] >= 0 else float(model.geom_rgba[k, 3])
        if k in collides or alpha == 0.0 or model.geom_group[k] >= HIDDEN:
            continue
        seen.append([_named(model, "geom", k), *row])
        if row[1] == mujoco.mjtGeom.mjGEOM_MESH:
            at = starts[row[-1]]
            faces[row[-1]] = model.mesh_face[at : at + counts[row[-1]]].tolist()
    return {"seen": seen, "faces": faces}


def _told(mujoco: Any, model: Any) -> dict[str, Any]:
    def named(kind: str, index: int) -> str:
        return _named(model, kind, index)

    def columns(*names: str) -> list[tuple[Any, ...]]:
        return _columns(model, *names)

    bodies = columns("body_parentid", "body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat", "body_inertia")
    joints = columns(
        *("jnt_bodyid", "jnt_type", "jnt_pos", "jnt_axis", "jnt_limited", "jnt_range"),
        *("jnt_qposadr", "jnt_actfrclimited", "jnt_actfrcrange"),
    )
    geoms, collides = columns(*GEOM), _colliding(model)
    follows, loops = [], []
    for k in range(model.neq):
        one, two = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if model.eq_active0[k] and model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT:
            follows.append([one, two, model.eq_data[k][:5].tolist()])
        elif model.eq_active0[k]:
            loops.append([mujoco.mjtEq(model.eq_type[k]).name[5:].lower(), named("equality", k)])
    starts = model.mesh_vertadr.tolist()
    ends = [*starts[1:], len(model.mesh_vert)]
    return {
        "name": model.names.split(b"\0", 1)[0].decode("utf-8", "replace"),
        "bodies": [[named("body", k), *row] for k, row in enumerate(bodies)],
        "joints": [
            [named("joint", k), *row, float(model.qpos0[at]), top if forced else 0.0]
            for k, (*row, at, forced, (_, top)) in enumerate(joints)
        ],
        "geoms": [[named("geom", k), *row] for k, row in enumerate(geoms) if k in collides],
        "sites": [
            [int(model.site_bodyid[k]), name, model.site_pos[k].tolist(), model.site_quat[k].tolist()]
            for k in range(model.nsite)
            if (name := str(model.site(k).name))
        ],
        "meshes": [model.mesh_vert[a:b].tolist() for a, b in zip(starts, ends, strict=False)],
        "excludes": [[pair >> 16, pair & 0xFFFF] for pair in model.exclude_signature.tolist()],
        "follows": follows,
        "loops": loops,
        "keys": [[named("key", k), model.key_qpos[k][model.jnt_qposadr].tolist()] for k in range(model.nkey)],
        "qpos": model.qpos0.tolist(),
        "velocities": int(model.nv),
        "places": [[str(model.joint(k).name), *row] for k, row in enumerate(columns("jnt_qposadr", "jnt_dofadr"))],
    }
