"""Many simulations of one model as one world: `BatchWorld`."""
