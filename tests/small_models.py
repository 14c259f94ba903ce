"""Models of few vertices, written as text by the tests' own hand."""

from formats.ply_files import Table, build

COLOURED = "float x y z, uchar red green blue"
_CORNERS = [(0, 0), (1, 0), (1, 1), (0, 1)]


def ply(properties, rows, faces=(), encoding="ascii", comments=()):
    """Return a PLY file of vertices, with properties as in COLOURED."""
    columns = [(name, kind) for kind, *names in map(str.split, properties.split(",")) for name in names]
    polygons = Table("face", [("vertex_indices", "uchar int")], [[list(face)] for face in faces])
    tables = [Table("vertex", columns, list(rows)), *([polygons] if len(faces) else [])]
    return build(tables, encoding, comments=list(comments)).data


def textured_squares(path, *squares):
    """Write an OBJ file and its library: for each square an image, its left edge, and what it shows of the image.

    That is from where to where, as a share of both the width and the height.
    """
    lines, materials = [f"mtllib {path.stem}.mtl"], []
    for number, (image, left, shown) in enumerate(squares):
        materials += [f"newmtl m{number}", f"map_Kd {image}"]
        lines += [f"v {left + x:g} {y} 0\nvt {shown[x]} {shown[y]}" for x, y in _CORNERS]
        lines += [f"usemtl m{number}", "f -4/-4 -3/-3 -2/-2 -1/-1"]
    path.write_text("\n".join([*lines, ""]))
    path.with_suffix(".mtl").write_text("\n".join([*materials, ""]))
    return path
