"""URDF models and OBJ meshes as texts, made of parts."""


def link(name, *, mass=1.0, com=(0, 0, 0), rpy=(0, 0, 0), shapes=""):
    """Returns a URDF link with an inertial frame, and collision elements."""
    return (
        f'<link name="{name}"><inertial><origin xyz="{_listed(com)}" rpy="{_listed(rpy)}"/>'
        f'<mass value="{mass}"/><inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial>{shapes}</link>"
    )


def collision(geometry, *, xyz=(0, 0, 0), rpy=(0, 0, 0)):
    """Returns a URDF collision element; the geometry is XML."""
    return (
        f'<collision><origin xyz="{_listed(xyz)}" rpy="{_listed(rpy)}"/>'
        f"<geometry>{geometry}</geometry></collision>"
    )


def joint(name, kind, parent, child, *, xyz=(0, 0, 0), rpy=(0, 0, 0), axis=(0, 0, 1), limit=""):
    """Returns a URDF joint; the limit is XML."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_listed(xyz)}" rpy="{_listed(rpy)}"/><axis xyz="{_listed(axis)}"/>'
        f"{limit}</joint>"
    )


def robot(*parts, name="model"):
    """Returns a URDF model."""
    return f'<robot name="{name}">{"".join(parts)}</robot>'


def box_obj(low, high, first=0, name=None):
    """Returns an OBJ box: text, with vertex numbers that begin behind `first`."""
    corners = [
        (x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])
    ]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"o {name}"] if name else []
    lines += [f"v {x} {y} {z}" for x, y, z in corners]
    lines += ["f " + " ".join(str(first + corner) for corner in face) for face in faces]
    return "\n".join(lines) + "\n"


def _listed(values):
    return " ".join(map(str, values))
