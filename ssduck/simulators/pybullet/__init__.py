"""PyBullet, behind the interface of `ssduck.simulators`.

`backend` is the entry: it makes simulations, copies them and saves them. `simulator` runs one; the
other modules read its bodies and set them. No other package of ssduck imports PyBullet.
"""
