"""The bodies and the sensors of the kitchen, and their places.

PyBullet lets hulls (and its many-sided cylinders) float 1 mm above their support. The scene leaves
this gap under things on hulls, so that nothing moves when the simulation starts.
"""

from __future__ import annotations

from tools.kitchen.appliances import (
    can,
    coffe_machine,
    cup,
    knife_block,
    microwave,
    mixer,
    pin,
    plate,
    shaker,
    toaster,
)
from tools.kitchen.furniture import (
    camera,
    chair,
    cooker_unit,
    fridge_unit,
    kitchen,
    sink,
    table,
)
from tools.kitchen.robots import barrett, roomba
from tools.scenes.bodies import Body, Sensor, looking
from tools.scenes.pieces import Span, Vec

APPLIANCES = [can(), coffe_machine(), mixer(), toaster(), microwave(), knife_block(), shaker()]
SMALL = [plate(), cup(), pin()]
FURNITURE = [kitchen(), chair(), table(), sink()]
FRIDGE, COOKER = (-0.87, -2.0, 1.55), (1.98, 1.72, 0.75)
CAMERAS = [camera("fridge", FRIDGE, fridge_unit()), camera("cooker", COOKER, cooker_unit())]
MODELS = [*CAMERAS, barrett(), roomba(), *FURNITURE, *SMALL, *APPLIANCES]

# The arm is folded above its base, hand down.
FOLDED = {"j1": 0.55, "j2": -0.35, "j4": 2.4, "j6": 0.9, "f1": 0.35, "f2": 0.35, "f3": 0.35}

ROBOTS = [
    Body("fridge", "robot", "fridge", FRIDGE, fixed=True),
    Body("cooker", "robot", "cooker", COOKER, fixed=True),
    Body("barrett_4918", "robot", "barrett_4918", (0.42, 1.3, 0.892), joints=FOLDED),
    Body("roomba_625x", "robot", "roomba_625x", (1.8, 0.0, 0.17)),
]


def kinbody(name: str, x: float, y: float, z: float, qw: float = 1.0, qz: float = 0.0) -> Body:
    """Returns a kinbody; its model is the name without the tag: `plate` of `plate_835a`."""
    model = name if name in {m.name for m in MODELS} else name.rsplit("_", 1)[0]
    fixed = model in {m.name for m in FURNITURE}
    return Body(name, "kinbody", model, (x, y, z), (qw, 0.0, 0.0, qz), fixed)


KINBODIES = [
    kinbody("kitchen", 0.0, 0.0, 0.0),
    kinbody("chair_2e39", 0.95, -1.15, 0.0, 0.82402, 0.56657),
    kinbody("chair_12d0", 0.43229, 0.17536, 0.0, 0.98286, -0.18433),
    kinbody("chair_6b56", 1.34, 0.27, 0.0, -0.08079, 0.99673),
    kinbody("chair_083c", 0.52, -0.6, 0.0),
    kinbody("table", 0.91704, -0.12644, 0.0),
    kinbody("plate_835a", 1.06, -0.73, 0.922),
    kinbody("plate_496f", 0.67, -0.45556, 0.922),
    kinbody("plate_fa76", 1.14, 0.0, 0.922),
    kinbody("plate_b4e7", -1.13, 2.01, 1.14),
    kinbody("cup_905a", 1.0, 0.433, 0.922),
    kinbody("cup_58a2", 0.61, 0.45, 0.922),
    kinbody("cup_b6af", 0.76, 0.55, 0.922),
    kinbody("cup_d441", 0.97, 0.58, 0.922),
    kinbody("sink", 0.35, 2.15, -0.1),
    kinbody("can", -1.25, -0.54, 0.97),
    kinbody("coffe_machine", -1.335, 0.96, 0.97),
    kinbody("mixer", 1.69, 2.3, 0.956),
    kinbody("toaster", -1.26, -1.18, 0.96, 0.94893, 0.3155),
    kinbody("microwave", -1.1, 2.0, 0.963),
    kinbody("pin_371e", -1.2, 1.4, 0.96),
    kinbody("pin_a091", -1.466, 2.27, 1.67),
    kinbody("pin_c671", -1.11, 2.286, 1.67),
    kinbody("knife_block", -0.51, 2.3, 0.968),
    kinbody("shaker", 2.13, 2.26, 0.98),
]

BELOW: Vec = (0.0, 0.0, -0.051)


def webcam(name: str, on: str, at: Vec, down: float, reach: float) -> Sensor:
    more = {"width": 64, "height": 48, "fov": 50.0}
    return Sensor(name, on, "depth_camera", at, looking(0, down), reach, more)


def laser(name: str, on: str, at: Vec, yaw: float, reach: float, sweep: Span) -> Sensor:
    more = {"min_angle": sweep[0], "max_angle": sweep[1], "resolution": 1.0}
    return Sensor(name, on, "planar_laser", at, looking(yaw), reach, more)


def distance(number: int, yaw: float, x: float, y: float) -> Sensor:
    name, on = f"roomba_625x_dist{number}", "roomba_625x"
    return Sensor(name, on, "range_finder", (x, y, 0.05), looking(yaw), 0.4, {})


SENSORS = [
    webcam("fridge_webcam", "fridge", BELOW, 35, 2.2),
    laser("cooker_motion_detector", "cooker", BELOW, -90, 1.0, (-45.0, 25.0)),
    laser("barrett_4918_laser_scaner", "barrett_4918", (0.35, 0.0, -0.65), 0, 3.0, (-90.0, 90.0)),
    webcam("roomba_625x_webcam_a40f", "roomba_625x", (0.0, -0.1, 0.2), 0, 1.0),
    distance(1, 0, 0.2, 0.0),
    distance(2, 90, 0.0, 0.2),
    distance(3, 180, -0.2, 0.0),
    distance(4, 270, 0.0, -0.2),
]
