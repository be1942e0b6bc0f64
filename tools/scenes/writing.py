"""Writes the files of a scene: URDFs, meshes and `scene.toml`."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from tools.scenes.bodies import Body, Sensor
from tools.scenes.masses import inertial
from tools.scenes.models import COLOURS, Joint, Link, Model, Shape
from tools.scenes.pieces import Piece, Vec

SCENES = Path(__file__).resolve().parents[2] / "scenes"


def number(value: float, digits: int = 12) -> str:
    """Returns a number with so few digits that the text is the same on every machine."""
    return f"{round(float(value), 12) + 0.0:.{digits}g}"


def numbers(values: Iterable[float], digits: int = 12) -> str:
    return " ".join(number(v, digits) for v in values)


def obj_text(pieces: Sequence[Piece]) -> str:
    lines, start = [], 1
    for i, piece in enumerate(pieces):
        lines.append(f"o piece{i}")
        lines += [f"v {numbers(v)}" for v in piece.vertices]
        lines += ["f " + " ".join(str(start + k) for k in face) for face in piece.faces]
        start += len(piece.vertices)
    return "\n".join(lines) + "\n"


def geometry(model: Model, shape: Shape) -> str:
    match shape.kind:
        case "box":
            return f'<box size="{numbers(shape.size)}"/>'
        case "cylinder":
            return f'<cylinder radius="{number(shape.size[0])}" length="{number(shape.size[1])}"/>'
        case "sphere":
            return f'<sphere radius="{number(shape.size[0])}"/>'
        case "capsule":
            radius, length = map(number, shape.size)
            return f'<capsule radius="{radius}" length="{length}"/>'
    return f'<mesh filename="meshes/{model.name}_{shape.part}.obj"/>'


def place(origin: Iterable[float], rpy: Vec = (0.0, 0.0, 0.0)) -> str:
    turn = f' rpy="{numbers(rpy)}"' if any(rpy) else ""
    return f'<origin xyz="{numbers(origin)}"{turn}/>'


def link_lines(model: Model, link: Link) -> Iterator[str]:
    centre, moments = inertial(link)
    ixx, iyy, izz = (number(m, 6) for m in moments)
    yield f'  <link name="{link.name}">'
    if link.slippery:
        yield '    <contact><lateral_friction value="0"/></contact>'
    if link.grips:
        yield '    <contact><lateral_friction value="1"/></contact>'
    yield f'    <inertial>{place(centre.round(6))}<mass value="{number(link.mass)}"/>'
    yield f'      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>'
    yield "    </inertial>"
    for shape in link.shapes:
        body = f"{place(shape.origin, shape.rpy)}<geometry>{geometry(model, shape)}</geometry>"
        if shape.collides:
            yield f"    <collision>{body}</collision>"
        if not shape.drawn:
            if any(other.drawn for other in link.shapes):
                continue
            # Without anything to draw PyBullet draws what collides.
            body = f'{place(shape.origin)}<geometry><box size="0.0001 0.0001 0.0001"/></geometry>'
        yield f'    <visual>{body}<material name="{shape.colour}"/></visual>'
    yield "  </link>"


def joint_lines(joint: Joint) -> Iterator[str]:
    yield f'  <joint name="{joint.name}" type="{joint.kind}">'
    yield f'    <parent link="{joint.parent}"/><child link="{joint.child}"/>'
    yield f"    {place(joint.origin, joint.rpy)}"
    if joint.limit:
        lower, upper, effort, velocity = (number(v) for v in joint.limit)
        bounds = "" if joint.kind == "continuous" else f'lower="{lower}" upper="{upper}" '
        yield f'    <axis xyz="{numbers(joint.axis)}"/>'
        yield f'    <limit {bounds}effort="{effort}" velocity="{velocity}"/>'
    yield "  </joint>"


def urdf_text(model: Model) -> str:
    used = {shape.colour for link in model.links for shape in link.shapes}
    lines = ['<?xml version="1.0"?>', f'<robot name="{model.name}">']
    for name in sorted(used):
        rgba = numbers((*COLOURS[name], 1.0))
        lines.append(f'  <material name="{name}"><color rgba="{rgba}"/></material>')
    for link in model.links:
        lines += link_lines(model, link)
    for joint in model.joints:
        lines += joint_lines(joint)
    return "\n".join([*lines, "</robot>"]) + "\n"


def array(values: Iterable[float]) -> str:
    return "[" + ", ".join(real(v) for v in values) + "]"


def real(value: float) -> str:
    """Returns a TOML number; a whole one stays whole."""
    return repr(value) if isinstance(value, int) else repr(round(value, 12) + 0.0)


def body_lines(body: Body) -> Iterator[str]:
    yield "\n[[body]]"
    yield f'name = "{body.name}"\nkind = "{body.kind}"\nurdf = "{body.model}.urdf"'
    yield f"position = {array(body.position)}\norientation = {array(body.orientation)}"
    if body.fixed:
        yield "fixed = true"
    if body.velocity:
        yield f"velocity = {array(body.velocity)}"
    if body.joints:
        values = ", ".join(f"{name} = {real(v)}" for name, v in body.joints.items())
        yield f"joints = {{ {values} }}"


def sensor_lines(sensor: Sensor) -> Iterator[str]:
    yield "\n[[sensor]]"
    yield f'name = "{sensor.name}"\non = "{sensor.on}"\ntype = "{sensor.type}"'
    yield f"position = {array(sensor.position)}\norientation = {array(sensor.orientation)}"
    yield f"period = {real(sensor.period)}\nmax_range = {real(sensor.max_range)}"
    for key, value in sensor.more.items():
        yield f"{key} = {real(value)}"


def scene_text(heading: str, bodies: Iterable[Body], sensors: Iterable[Sensor]) -> str:
    lines = [heading.strip()]
    for body in bodies:
        lines += body_lines(body)
    for sensor in sensors:
        lines += sensor_lines(sensor)
    return "\n".join(lines) + "\n"


def files(scene: str, models: Iterable[Model]) -> dict[Path, str]:
    """Returns the files of a scene by path: `scene.toml` with its text, and the models."""
    texts = {Path("scene.toml"): scene}
    for model in models:
        texts[Path(f"{model.name}.urdf")] = urdf_text(model)
        for shape in (shape for link in model.links for shape in link.shapes):
            if shape.kind == "mesh":
                texts[Path(f"meshes/{model.name}_{shape.part}.obj")] = obj_text(shape.pieces)
    return texts


def write(name: str, texts: dict[Path, str]) -> int:
    """Writes the folder of a scene, or compares it with the files; returns the exit status."""
    parser = argparse.ArgumentParser(description=f"Write the scene {name}.")
    parser.add_argument("--check", action="store_true", help="only report files that differ")
    check = parser.parse_args().check
    folder = SCENES / name
    there = {p.relative_to(folder): p.read_text() for p in folder.rglob("*") if p.is_file()}
    differing = sorted(p for p in texts.keys() | there.keys() if texts.get(p) != there.get(p))
    for path in differing:
        print(path)
        if check:
            continue
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        if path in texts:
            (folder / path).write_text(texts[path])
        else:
            (folder / path).unlink()
    return 1 if check and differing else 0
