"""SDF and MJCF files as texts, made of parts."""

_AXES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_MOMENTS = "".join(f"<{k}>{v}</{k}>" for k, v in zip(_AXES, (0.1, 0, 0, 0.2, 0, 0.25), strict=True))
BOX = "<box><size>0.4 0.2 0.6</size></box>"


def sdf_link(name="l", *, geometry=BOX, mass=1.0, com="0 0 0 0 0 0", extra=""):
    """Returns a link of an SDF model with a collision shape and an inertial frame."""
    return (
        f'<link name="{name}"><inertial><pose>{com}</pose><mass>{mass}</mass>'
        f"<inertia>{_MOMENTS}</inertia></inertial>"
        f'<collision name="c"><geometry>{geometry}</geometry></collision>'
        f'<visual name="v"><geometry>{geometry}</geometry></visual>{extra}</link>'
    )


def sdf_model(name, *parts, pose="0 0 0 0 0 0"):
    """Returns a model of an SDF file; without parts it has one link with a box."""
    return f'<model name="{name}"><pose>{pose}</pose>{"".join(parts) or sdf_link()}</model>'


def sdf_of(*parts):
    """Returns an SDF file of one world."""
    return f'<sdf version="1.6"><world name="w">{"".join(parts)}</world></sdf>'


def mjcf_body(name=None, *, pos="0 0 0", parts='<geom type="box" size="0.2 0.1 0.3"/>'):
    """Returns a free body of an MJCF file."""
    named = f'name="{name}" ' if name else ""
    return f'<body {named}pos="{pos}"><joint type="free"/>{parts}</body>'


def mjcf_of(*parts, model="m", before="", after=""):
    """Returns an MJCF file."""
    world = f"<worldbody>{''.join(parts)}</worldbody>"
    return f'<mujoco model="{model}">{before}{world}{after}</mujoco>'
