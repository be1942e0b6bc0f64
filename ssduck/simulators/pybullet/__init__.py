"""PyBullet behind the interface of `ssduck.simulators`.

`backend` is the entry: it makes simulations and saves them. `simulator` runs one, and reads its
bodies through the modules beside it. Nothing else in ssduck imports PyBullet.
"""
