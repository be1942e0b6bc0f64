"""Describes the bodies of a MuJoCo model: the trees of bodies below the world body.

A tree is an entity, its bodies are the links, its root the base. MuJoCo numbers bodies depth first,
so that the bodies of a tree have consecutive numbers. The trees of a flex are one entity: the first
of its bodies is the base, which the other roots are linked to. The world body is an entity of its
own if it has geoms that collide, or sites. Sites are links without mass after the others, each
fixed to the body that it is on. Names are MuJoCo's.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ssduck.geometry.arrays import Array, Indices
from ssduck.geometry.shapes import Geometry, PlacedGeometry
from ssduck.simulators.interface import SCALAR_JOINTS, Body, Joint, Kind, Link
from ssduck.simulators.model_xml import KIND_PREFIX, MJCF_SIZES
from ssduck.simulators.mujoco.contacts import margins_of
from ssduck.simulators.mujoco.flexes import entity_roots, flex_names, flex_shapes
from ssduck.simulators.mujoco.library import mujoco

_GEOM, _JOINT, _OBJECT = mujoco.mjtGeom, mujoco.mjtJoint, mujoco.mjtObj
# The types of joints by MuJoCo's numbers.
_JOINT_TYPES = {
    int(_JOINT.mjJNT_FREE): "free",
    int(_JOINT.mjJNT_BALL): "spherical",
    int(_JOINT.mjJNT_SLIDE): "prismatic",
    int(_JOINT.mjJNT_HINGE): "revolute",
}
# The primitives by MuJoCo's numbers.
_PRIMITIVES: Mapping[int, Any] = {
    int(getattr(_GEOM, f"mjGEOM_{name.upper()}")): name for name in MJCF_SIZES
}
# The arrays of a model that describe shapes and joints, and that users may change at any time.
_MUTABLE = (
    "geom_size",
    "geom_pos",
    "geom_quat",
    "geom_contype",
    "geom_conaffinity",
    "jnt_range",
    "jnt_limited",
    "jnt_pos",
    "jnt_axis",
    "qpos0",
    "site_size",
)


class ModelContent:
    """The content of a model's arrays that describe shapes and joints, as it was."""

    def __init__(self, model: Any) -> None:
        # The arrays are views of the model's memory: each tick compares them.
        self._views = [getattr(model, name) for name in _MUTABLE]
        self._content = self._present()
        self._heights, self._known_heights = model.hfield_data, model.hfield_data.copy()

    def is_present(self) -> bool:
        """Checks whether the model has this content now; copies no heights, which may be many."""
        return self._present() == self._content and (
            not self._heights.size or np.array_equal(self._heights, self._known_heights)
        )

    def _present(self) -> list[bytes]:
        return [view.tobytes() for view in self._views]


def name_of(model: Any, type: Any, number: int, noun: str) -> str:
    """Returns MuJoCo's name of a part of a model; its noun and number if it has none."""
    return mujoco.mj_id2name(model, type, number) or f"{noun}_{number}"


def unread_parts(model: Any) -> dict[str, str]:
    """Returns the kinds of the named parts of a model that worlds do not read."""
    return {
        name: kind
        for kind, (type, size) in _UNREAD.items()
        for number in range(getattr(model, size))
        if (name := mujoco.mj_id2name(model, type, number))
    }


def body_names(model: Any) -> list[str]:
    """Returns the names of all bodies of a model."""
    return [name_of(model, _OBJECT.mjOBJ_BODY, n, "body") for n in range(model.nbody)]


def roots_of(model: Any) -> list[int]:
    """Returns the numbers of the roots of all trees, the world body first."""
    numbers = np.arange(model.nbody)
    return [int(number) for number in np.flatnonzero(entity_roots(model) == numbers)]


# The kinds of such parts, with MuJoCo's types and the names of their numbers.
_UNREAD = {
    "keyframe": (_OBJECT.mjOBJ_KEY, "nkey"),
    "texture": (_OBJECT.mjOBJ_TEXTURE, "ntex"),
    "mesh": (_OBJECT.mjOBJ_MESH, "nmesh"),
    "material": (_OBJECT.mjOBJ_MATERIAL, "nmat"),
    "light": (_OBJECT.mjOBJ_LIGHT, "nlight"),
    "camera": (_OBJECT.mjOBJ_CAMERA, "ncam"),
    "tendon": (_OBJECT.mjOBJ_TENDON, "ntendon"),
    "actuator": (_OBJECT.mjOBJ_ACTUATOR, "nu"),
    "sensor": (_OBJECT.mjOBJ_SENSOR, "nsensor"),
}


class ModelReader:
    """Describes the bodies of a model.

    Args:
        model: the model.
        names: names of entities by the number or the name of the root, instead of MuJoCo's.
        kinds: kinds of entities, likewise.
        only: the numbers of the roots of the trees to describe; None for all.
        disabled: geoms that count as colliding, though they do not at present; None for none.
        part_names: names of links and joints, instead of MuJoCo's.
    """

    def __init__(
        self,
        model: Any,
        names: Mapping[int | str, str] | None,
        kinds: Mapping[int | str, Kind] | None,
        only: Collection[int] | None = None,
        disabled: Indices | None = None,
        part_names: Mapping[str, str] | None = None,
    ) -> None:
        self._model, self._only = model, only
        self._names, self._kinds, self._part_names = names or {}, kinds or {}, part_names or {}
        self._root_names, self._flex_names = body_names(model), flex_names(model)
        self._link_names = [self._part_names.get(name, name) for name in self._root_names]
        self._geoms = _by_owner(model.geom_bodyid, colliding_geoms(model, disabled), model.nbody)
        self._margins = margins_of(model).listed
        self._flex_shapes: dict[int, list[tuple[int, PlacedGeometry]]] = defaultdict(list)
        for body, number, shape in flex_shapes(model, disabled):
            placed = replace(shape, margin=self._margins[number])
            self._flex_shapes[body].append((number, placed))
        # The numbers of the geoms and flexes that the shapes of the described bodies are of.
        self.parts: dict[Body, Indices] = {}
        self._joints = _by_owner(model.jnt_bodyid, np.arange(model.njnt), model.nbody)
        self._geometries: dict[int, Geometry] = {}
        self._unread = unread_parts(model)

    def bodies(self) -> list[Body]:
        """Returns all bodies, in the order of their numbers."""
        roots = roots_of(self._model)
        ends = [*roots[1:], self._model.nbody]
        # The world body is an entity if it has geoms or sites.
        has_world = self._geoms[0] or self._flex_shapes[0] or sites_on(self._model, range(1))
        return [
            self._body(root, range(root, end))
            for root, end in zip(roots, ends, strict=True)
            if (root or has_world) and (self._only is None or root in self._only)
        ]

    def _body(self, root: int, links: range) -> Body:
        model = self._model
        joints = tuple(self._joint(n, link - root) for link in links for n in self._joints[link])
        name, own_name = self._root_names[root], self._flex_names.get(root, self._root_names[root])
        kind: Kind = "kinbody" if root in self._flex_names else kind_by_joints(joints)
        flexes = [(link, *part) for link in links for part in self._flex_shapes[link]]
        geoms = [(link, number) for link in links for number in self._geoms[link]]
        body = Body(
            handle=root,
            name=self._names.get(name, self._names.get(root, own_name)),
            kind=self._kinds.get(own_name, self._kinds.get(name, self._kinds.get(root, kind))),
            movable=bool(joints) or bool((model.body_mocapid[links.start : links.stop] >= 0).any()),
            links=(*(self._link(number, root) for number in links), *self._site_links(links)),
            joints=joints,
            shapes=(
                *(self._shape(number, link - root) for link, number in geoms),
                *(replace(shape, frame=link - root) for link, _, shape in flexes),
            ),
            unread=self._unread,
        )
        numbers = [number for _, number in geoms] + [number for _, number, _ in flexes]
        self.parts[body] = np.array(numbers, np.intp)
        return body

    def _link(self, number: int, root: int) -> Link:
        model = self._model
        parent = -1 if number == root else max(int(model.body_parentid[number]) - root, 0)
        first = int(model.body_geomadr[number])
        ids = range(first, first + int(model.body_geomnum[number]))
        names = [mujoco.mj_id2name(model, _OBJECT.mjOBJ_GEOM, id) for id in ids]
        mass, geoms = float(link_masses(model)[number]), tuple(filter(None, names))
        return Link(self._link_names[number], parent, mass, geoms=geoms)

    def _site_links(self, links: range) -> Iterator[Link]:
        """Yields the sites on some bodies; a name that a body has gets `_site` appended."""
        taken = {self._link_names[number] for number in links}
        for number in sites_on(self._model, links):
            name = name_of(self._model, _OBJECT.mjOBJ_SITE, number, "site")
            while name in taken:
                name += "_site"
            taken.add(name)
            parent = int(self._model.site_bodyid[number]) - links.start
            yield Link(name, parent, 0.0, region_of(self._model, number))

    def _joint(self, number: int, link: int) -> Joint:
        model = self._model
        type: Any = _JOINT_TYPES[int(model.jnt_type[number])]
        is_scalar = type in SCALAR_JOINTS
        lower = upper = max_effort = None
        if is_scalar and model.jnt_limited[number]:
            lower, upper = model.jnt_range[number].tolist()
        if model.jnt_actfrclimited[number]:
            max_effort = float(np.abs(model.jnt_actfrcrange[number]).max())
        name = name_of(model, _OBJECT.mjOBJ_JOINT, number, "joint")
        return Joint(
            self._part_names.get(name, name),
            type,
            link,
            lower,
            upper,
            max_effort,
            max_velocity=None,
            axis=tuple(model.jnt_axis[number].tolist()) if is_scalar else (0.0, 0.0, 0.0),
            anchor=tuple(model.jnt_pos[number].tolist()),
            reference=float(model.qpos0[model.jnt_qposadr[number]]) if is_scalar else 0.0,
        )

    def _shape(self, number: int, link: int) -> PlacedGeometry:
        model = self._model
        geometry, centre, is_exact = geometry_of(model, number)
        geometry = self._geometries.setdefault(number, geometry)
        pose = pose_of(model, number, centre)
        return PlacedGeometry(link, geometry, *pose, self._margins[number], is_exact)


def kind_by_joints(joints: Iterable[Joint]) -> Kind:
    """Returns the kind of a body with some joints, unless something else tells it."""
    return "robot" if any(joint.type != "free" for joint in joints) else "kinbody"


def kinds_in(model: Any) -> dict[int | str, Kind]:
    """Returns the kinds of entities that texts of a model tell, by the names of the roots."""
    kinds: dict[int | str, Kind] = {}
    for number in range(model.ntext):
        name = name_of(model, _OBJECT.mjOBJ_TEXT, number, "text")
        start, size = int(model.text_adr[number]), int(model.text_size[number])
        text = bytes(model.text_data[start : start + size]).rstrip(b"\0")
        if name.startswith(KIND_PREFIX) and text in (b"robot", b"kinbody"):
            kinds[name.removeprefix(KIND_PREFIX)] = "robot" if text == b"robot" else "kinbody"
    return kinds


def link_masses(model: Any) -> Array:
    """Returns the masses of all bodies, kg; 0 for those that are fixed to the world."""
    # To MuJoCo before 3.4, bodies that move as mocap bodies are fixed to the world.
    is_driven = model.body_mocapid[model.body_rootid] >= 0
    is_fixed = (model.body_weldid == 0) & ~is_driven
    masses: Array = np.where(is_fixed, 0.0, model.body_mass)
    return masses


def sites_on(model: Any, links: range) -> list[int]:
    """Returns the sites on some bodies, in their order."""
    owners = model.site_bodyid
    numbers: list[int] = np.flatnonzero((owners >= links.start) & (owners < links.stop)).tolist()
    return numbers


def numbers_of(body: Body) -> range:
    """Returns MuJoCo's numbers of the bodies that are the links of a body, without its sites."""
    return range(body.handle, body.handle + body.rigid_count)


def number_of(body: Body, link: int) -> int:
    """Returns MuJoCo's number of a link's body, of a site that of its parent."""
    is_site = body.links[link].region is not None
    return body.handle + (body.links[link].parent if is_site else link)


def joint_numbers(model: Any, bodies: Sequence[Body]) -> Indices:
    """Returns MuJoCo's numbers of the joints of some bodies, in order."""
    first, count = model.body_jntadr, model.body_jntnum
    links = [number for body in bodies for number in numbers_of(body)]
    numbers = [number for n in links for number in range(first[n], first[n] + count[n])]
    return np.array(numbers, dtype=np.intp)


def colliding_geoms(model: Any, disabled: Indices | None = None) -> Indices:
    """Returns the numbers of the geoms that can collide, and of those that are only disabled."""
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    if disabled is not None:
        collides[disabled[disabled < model.ngeom]] = True
    for pairs in (model.pair_geom1, model.pair_geom2):
        collides[pairs] = True
    numbers: Indices = np.flatnonzero(collides)
    return numbers


def _by_owner(owners: Any, numbers: Indices, count: int) -> list[list[int]]:
    """Returns the parts of each of a count of bodies, in their order."""
    parts: list[list[int]] = [[] for _ in range(count)]
    for number in numbers.tolist():
        parts[owners[number]].append(number)
    return parts


def geometry_of(model: Any, number: int) -> tuple[Geometry, Array, bool]:
    """Returns the shape of a geom, its centre in the geom's frame, and whether it is exact."""
    type = int(model.geom_type[number])
    centre = np.zeros(3)
    primitive = _primitive(type, model.geom_size[number].tolist())
    if primitive is not None:
        return primitive, centre, True
    if type == _GEOM.mjGEOM_PLANE:
        return Geometry.primitive("plane", (0, 0, 1)), centre, True
    if type == _GEOM.mjGEOM_MESH:
        return Geometry.hull(_hull_vertices(model, int(model.geom_dataid[number]))), centre, True
    if type == _GEOM.mjGEOM_HFIELD:
        return height_field(model, int(model.geom_dataid[number])), centre, True
    box = model.geom_aabb[number]
    return Geometry.primitive("box", 2 * box[3:]), box[:3].copy(), False


def pose_of(model: Any, number: int, centre: Array) -> tuple[Array, Array]:
    """Returns the pose, in the frame of its body, of a shape with a centre in the geom's frame."""
    position, orientation = model.geom_pos[number].copy(), model.geom_quat[number].copy()
    if centre.any():
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, orientation)
        position += matrix.reshape(3, 3) @ centre
    return position, orientation


def region_of(model: Any, number: int) -> Geometry:
    """Returns the region of a site."""
    size = model.site_size[number]
    region = _primitive(int(model.site_type[number]), size.tolist())
    return region or Geometry.primitive("box", 2 * size)


def _primitive(type: int, size: Sequence[float]) -> Geometry | None:
    """Returns the shape of a geom or a site; None for a plane, a mesh and a field."""
    if type not in _PRIMITIVES:
        return None
    name = _PRIMITIVES[type]
    sizes = [n / part for n, part in zip(size, MJCF_SIZES[name], strict=False)]
    return Geometry.primitive(name, (*sizes, 0.0, 0.0)[:3])


def _hull_vertices(model: Any, mesh: int) -> Array:
    """Returns the corners of the hull by which MuJoCo collides a mesh, in the mesh's frame."""
    first = int(model.mesh_vertadr[mesh])
    vertices: Array = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)
    graph = int(model.mesh_graphadr[mesh])
    if graph < 0:
        return vertices
    # The graph: the number of corners, that of faces, an address for each corner, its number.
    count = int(model.mesh_graph[graph])
    start = graph + 2 + count
    corners: Array = vertices[model.mesh_graph[start : start + count]]
    return corners


def is_same(one: Body, other: Body) -> bool:
    """Checks whether two descriptions of a body are the same but for their identity."""
    return _content(one) == _content(other)


def _content(body: Body) -> tuple[Any, ...]:
    links = [(link.name, link.parent, link.region and link.region.key) for link in body.links]
    shapes = [
        (shape.frame, shape.geometry.key, shape.exact, *shape.position, *shape.orientation)
        for shape in body.shapes
    ]
    return body.handle, body.name, body.kind, body.movable, body.joints, links, shapes


def height_field(model: Any, number: int) -> Geometry:
    """Returns the solid under a height field, as MuJoCo collides it, in the frame of its shape.

    MuJoCo divides each cell by the diagonal from its first to its last corner, and puts a prism
    under each triangle, which ends at the bottom of the field. The closed surface of all prisms is
    the same solid.
    """
    rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
    x_half, y_half, height, depth = model.hfield_size[number].tolist()
    first = int(model.hfield_adr[number])
    heights = model.hfield_data[first : first + rows * columns].astype(np.float64) * height
    xs, ys = np.linspace(-x_half, x_half, columns), np.linspace(-y_half, y_half, rows)
    x, y = np.meshgrid(xs, ys)
    top = np.column_stack((x.reshape(-1), y.reshape(-1), heights))
    numbers = np.arange(rows * columns).reshape(rows, columns)
    # The vertices of the outline, to the left around it.
    sides = numbers[0, :-1], numbers[:-1, -1], numbers[-1, :0:-1], numbers[:0:-1, 0]
    outline = np.concatenate(sides)
    below = len(top) + np.arange(len(outline))
    bottom = top[outline]
    bottom[:, 2] = -depth
    centre = np.array([[0.0, 0.0, -depth]])
    following, following_below = np.roll(outline, -1), np.roll(below, -1)
    middle = np.full(len(below), len(top) + len(below))
    here, right = numbers[:-1, :-1].reshape(-1), numbers[:-1, 1:].reshape(-1)
    ahead, diagonal = numbers[1:, :-1].reshape(-1), numbers[1:, 1:].reshape(-1)
    triangles = (
        (here, right, diagonal),
        (here, diagonal, ahead),
        (outline, below, following_below),
        (outline, following_below, following),
        (below, middle, following_below),
    )
    vertices = np.concatenate((top, bottom, centre))
    faces = np.hstack(triangles).T.astype(np.int32)
    return Geometry("mesh", (0.0, 0.0, 0.0), vertices, faces)
