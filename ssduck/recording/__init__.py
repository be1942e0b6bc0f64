"""Records the ticks of worlds and replays them.

`spec` defines what is recorded. A `Recorder` gets each tick, copies its rows into `buffers` and
passes them to one of the `stores` in a thread (`background_writer`). `replay` reads them back: as
rows, as entities and as whole worlds.
"""
