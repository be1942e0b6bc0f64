"""PyBullet behind the interface of `ssduck.simulators`.

`backend` is the entry point: it makes, copies and saves simulations. `simulator` runs one, and
reads its bodies through the modules beside it. Nothing else in ssduck imports PyBullet.
"""
