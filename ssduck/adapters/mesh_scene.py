"""Defines `MeshScene`, a scene of trimesh that notebooks display."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from PIL import Image

from ssduck.adapters.charts import draw_triangles, png


class MeshScene(trimesh.Scene):
    """A scene of trimesh in the world frame, m; the metadata of a mesh has its `entity`."""

    def image(self) -> Image.Image:
        """Returns a picture with axes in metres and a colour for each entity."""
        triangles, names = [np.zeros((0, 3, 3))], []
        owners: list[int] = []
        indices: dict[str, int] = {}
        graph: Any = self.graph
        for node in graph.nodes_geometry:
            pose, geometry = graph[node]
            mesh: Any = self.geometry[geometry]
            corners = np.asarray(mesh.triangles)
            triangles.append(corners @ pose[:3, :3].T + pose[:3, 3])
            entity = str(mesh.metadata.get("entity", node))
            owners += [indices.setdefault(entity, len(indices))] * len(corners)
        names = list(indices)
        return draw_triangles(np.concatenate(triangles), np.array(owners, dtype=np.intp), names)

    def _repr_png_(self) -> bytes:
        """Returns `image()` as a PNG picture for notebooks."""
        return png(self.image())
