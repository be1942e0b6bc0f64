// What a result looks like where it is: grids on the floor, and clouds of points.

import * as THREE from "three";

// Above the floor, so that it is seen, m.
const GAP = 0.004;
// The size of a point, pixels.
const POINT = 3;
const MAX_OPACITY = 0.85;

export function gridOf({ origin, resolution, shape, shares }, floor) {
  const [columns, rows] = shape;
  const cells = bytesOf(shares);
  const pixels = new Uint8Array(4 * columns * rows);
  for (let x = 0; x < columns; x++) {
    for (let y = 0; y < rows; y++) {
      const share = cells[x * rows + y] / 255;
      const place = 4 * (y * columns + x);
      pixels[place] = 255 - 60 * share;
      pixels[place + 1] = 255 - 190 * share;
      pixels[place + 2] = 255 - 235 * share;
      pixels[place + 3] = 255 * (share ? 0.35 + (MAX_OPACITY - 0.35) * share : 0.3);
    }
  }
  const texture = new THREE.DataTexture(pixels, columns, rows);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.magFilter = texture.minFilter = THREE.NearestFilter;
  texture.needsUpdate = true;
  const material = new THREE.MeshBasicMaterial({ map: texture, transparent: true, depthWrite: false });
  material.side = THREE.DoubleSide;
  const [width, height] = [columns * resolution, rows * resolution];
  const mesh = new THREE.Mesh(new THREE.PlaneGeometry(width, height), material);
  mesh.position.set(origin[0] + width / 2, origin[1] + height / 2, floor + GAP);
  mesh.renderOrder = 1;
  return mesh;
}

export function cloudOf({ points, owners, size }, palette) {
  const places = new Float32Array(bytesOf(points).buffer);
  const numbers = new Uint32Array(bytesOf(owners).buffer);
  const colours = new Float32Array(places.length);
  numbers.forEach((number, index) => {
    const colour = palette[number % palette.length].clone().offsetHSL(0, 0.35, 0);
    colour.toArray(colours, 3 * index);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  const kind = size === null ? { size: POINT * window.devicePixelRatio, sizeAttenuation: false } : { size };
  const material = new THREE.PointsMaterial({ ...kind, vertexColors: true });
  return new THREE.Points(geometry, material);
}

function bytesOf(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}
