"""Fill loops of the CPU ray caster: depth and colour of the samples that a geom covers.

The tiles of a geom in one strip are contiguous in memory: one branch-free loop draws them, which
the compiler vectorizes over the sixteen samples of a tile. Triangles of a mesh are drawn one after
the other by such a loop that only notes which triangle is nearest; the samples that show the mesh
are shaded once at the end. In small images most triangles of a fine mesh lie between the samples
and are skipped.
"""

from collections.abc import Callable

from numpy import float32, int32

from knowarm.arrays import Floats32
from knowarm.world.render import intersections
from knowarm.world.render.intersections import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    Faces,
    Hit,
    blend,
    face_planes,
    triangle,
)
from knowarm.world.render.numeric import (
    ONE,
    ZERO,
    Integers32,
    Matrix,
    Paint,
    Vector,
    kernel,
    matrix_at,
    minus,
    scalar,
    shade,
    to_parent,
    vector_at,
    write_vector,
)
from knowarm.world.render.scenery import Meshes
from knowarm.world.render.tiles import (
    BITS,
    NEAR,
    TILE,
    TileGrid,
    Window,
    is_empty,
    sample_direction,
    samples_within,
    tiles_of,
)

Field = tuple[Floats32, Integers32]
"""Depth [m] and value (packed colour or geom id) of the samples, (strips, rows * TILE) each."""

PROJECTION = 3  # Numbers stored per vertex: X, Y, and z in the camera frame


@scalar
def rows_of(field: Field, strip: int, first: int, stop: int) -> Field:
    """Return the samples of some rows of a strip."""
    depth, value = field
    samples = slice(first * TILE, stop * TILE)
    return depth[strip, samples], value[strip, samples]


@scalar
def _window(extent: Integers32) -> Window:
    """Read the window of a projected geom."""
    return extent[2], extent[3], extent[4], extent[5]


@scalar
def _light(record: Floats32) -> tuple[Vector, Vector, Paint]:
    """Read the directions towards headlight and directional light, and the paint."""
    return vector_at(record, 9), vector_at(record, 15), matrix_at(record, 18)


@scalar
def _lane_direction(
    k: int, strip: int, upper: int, frame: Matrix, grid: TileGrid
) -> Vector:
    """Return the direction of the ray through sample k of the tiles of a strip from a row on.

    The numbers are int32 so that they are as wide as the float32 ones in a vector register.
    """
    lane = int32(k)
    column = int32(int32(strip * TILE) + (lane & int32(TILE - 1)))
    row = int32(int32(upper) + (lane >> int32(BITS)))
    return sample_direction(column, row, frame, grid)


@scalar
def _keep_nearer(
    depth: Floats32, value: Integers32, k: int, t: float32, new: int32
) -> None:
    """Replace sample k by what lies at depth t if that is nearer, without branching."""
    old_depth = depth[k]
    old_value = value[k]
    nearer = t < old_depth
    depth[k] = t if nearer else old_depth
    value[k] = new if nearer else old_value


@kernel
def _fill(
    hit: Callable[..., Hit],
    record: Floats32,
    extent: Integers32,
    grid: TileGrid,
    field: Field,
    ids: bool,
) -> None:
    """Draw a projected primitive, which ``hit`` intersects with rays."""
    geom = extent[1]
    origin = vector_at(record, 0)
    frame = matrix_at(record, 3)
    size = vector_at(record, 12)
    head, sun, paint = _light(record)
    first, stop, upper, lower = tiles_of(_window(extent))
    for strip in range(first, stop):
        depth, value = rows_of(field, strip, upper, lower)
        for k in range(len(depth)):
            t, normal = hit(origin, _lane_direction(k, strip, upper, frame, grid), size)
            colour = shade(normal, head, sun, paint)
            _keep_nearer(depth, value, k, t, geom if ids else colour)


@kernel
def _fill_triangle(
    planes: Faces,
    window: Window,
    frame: Matrix,
    mark: int32,
    grid: TileGrid,
    field: Field,
) -> None:
    """Note ``mark`` in the columns and rows of samples where a triangle is nearest."""
    first, stop, upper, lower = tiles_of(window)
    for strip in range(first, stop):
        depth, value = rows_of(field, strip, upper, lower)
        for k in range(len(depth)):
            t, _ = triangle(planes, _lane_direction(k, strip, upper, frame, grid))
            _keep_nearer(depth, value, k, t, mark)


@kernel
def _shade_triangles(
    record: Floats32, extent: Integers32, grid: TileGrid, meshes: Meshes, field: Field
) -> None:
    """Replace the triangles' marks in the samples of a mesh by their colours."""
    eye = vector_at(record, 0)
    frame = matrix_at(record, 3)
    head, sun, paint = _light(record)
    first, stop, upper, lower = tiles_of(_window(extent))
    for strip in range(first, stop):
        _, value = rows_of(field, strip, upper, lower)
        for k in range(len(value)):
            mark = value[k]
            if mark >= 0:
                continue
            face = -1 - mark
            a, b, c = corners(meshes, face, eye)
            direction = _lane_direction(k, strip, upper, frame, grid)
            _, weights = triangle(face_planes(a, b, c), direction)
            normal = blend(weights, matrix_at(meshes.normal[face], 0))
            value[k] = shade(normal, head, sun, paint)


@kernel
def fill_primitive(
    record: Floats32, extent: Integers32, grid: TileGrid, field: Field, ids: bool
) -> None:
    """Draw a projected primitive."""
    # Functions that are passed as globals of this module would keep Numba from caching.
    kind = extent[0]
    if kind == BOX:
        _fill(intersections.box, record, extent, grid, field, ids)
    elif kind == CYLINDER:
        _fill(intersections.cylinder, record, extent, grid, field, ids)
    elif kind == CAPSULE:
        _fill(intersections.capsule, record, extent, grid, field, ids)
    elif kind == SPHERE:
        _fill(intersections.sphere, record, extent, grid, field, ids)
    elif kind == ELLIPSOID:
        _fill(intersections.ellipsoid, record, extent, grid, field, ids)
    elif kind == PLANE:
        _fill(intersections.plane, record, extent, grid, field, ids)


@scalar
def _corner(meshes: Meshes, vertex: int, origin: Vector) -> Vector:
    """Return a vertex relative to an origin in the geom's frame [m]."""
    return minus(vector_at(meshes.vertex[vertex], 0), origin)


@scalar
def corners(meshes: Meshes, face: int, origin: Vector) -> Matrix:
    """Return the corners of a triangle relative to an origin in the geom's frame [m]."""
    vertices = meshes.face[face]
    return (
        _corner(meshes, vertices[0], origin),
        _corner(meshes, vertices[1], origin),
        _corner(meshes, vertices[2], origin),
    )


@scalar
def _visible_winding(meshes: Meshes, geom: int, eye: Vector) -> float32:
    """Return the winding of the triangles that face the eye, 0 if all have to be drawn.

    Seen from outside, the far side of a closed mesh is hidden by its near side.
    """
    x, y, z = minus(eye, vector_at(meshes.middle[geom], 0))
    half_x, half_y, half_z = vector_at(meshes.half[geom], 0)
    outside = (abs(x) > half_x) | (abs(y) > half_y) | (abs(z) > half_z)
    return float32(meshes.winding[geom]) if outside else ZERO


@kernel
def fill_mesh(
    record: Floats32,
    extent: Integers32,
    grid: TileGrid,
    meshes: Meshes,
    projection: Floats32,
    field: Field,
    ids: bool,
) -> None:
    """Draw a projected mesh; ``projection`` is working memory (see ``Scratch``)."""
    geom = extent[1]
    eye = vector_at(record, 0)
    frame = matrix_at(record, 3)
    winding = _visible_winding(meshes, geom, eye)
    span = meshes.span[geom]
    first = span[0]
    for i in range(span[1] - first):
        x, y, z = to_parent(frame, _corner(meshes, first + i, eye))
        inverse = -ONE / z  # of points behind the eye, X and Y are not used
        write_vector(projection[i], 0, (x * inverse, y * inverse, z))
    for face in range(span[2], span[3]):
        vertices = meshes.face[face]
        ax, ay, az = vector_at(projection[vertices[0] - first], 0)
        bx, by, bz = vector_at(projection[vertices[1] - first], 0)
        cx, cy, cz = vector_at(projection[vertices[2] - first], 0)
        window = _window(extent)
        if max(az, bz, cz) <= -NEAR:
            turn = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
            if turn * winding < ZERO:
                continue
            left = min(ax, bx, cx)
            right = max(ax, bx, cx)
            bottom = min(ay, by, cy)
            top = max(ay, by, cy)
            window = samples_within((left, right, bottom, top), window, grid)
        if is_empty(window):
            continue
        a, b, c = corners(meshes, face, eye)
        mark = int32(geom if ids else -1 - face)
        _fill_triangle(face_planes(a, b, c), window, frame, mark, grid, field)
    if not ids:
        _shade_triangles(record, extent, grid, meshes, field)
