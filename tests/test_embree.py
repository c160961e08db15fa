"""The reference against brute force, differences and displaced rays; and a planted fault that must be seen."""

from dataclasses import replace

import numpy as np
import pytest

from sdfbake.complaint import BadInput
from sdfbake.mesh import Mesh
from validate.beam import MeshRays, displace
from validate.displaced import richardson
from validate.embree import MeshReference

NORMALS = ("faceted", "area", "angle")


def torus(around: int = 48, across: int = 24, radius: float = 1.0, tube: float = 0.4) -> Mesh:
    """A torus about z, with texture coordinates that wrap once each way."""
    i, j = np.meshgrid(np.arange(around + 1), np.arange(across + 1), indexing="ij")
    a, b = 2 * np.pi * i / around, 2 * np.pi * j / across
    ring = radius + tube * np.cos(b)
    p = np.stack([ring * np.cos(a), ring * np.sin(a), tube * np.sin(b)], axis=-1)[:-1, :-1].reshape(-1, 3)
    uv = np.stack([i / around, j / across], axis=-1)
    corner = np.stack([np.arange(around).repeat(across), np.tile(np.arange(across), around)], axis=1)
    steps = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])
    nodes = (corner[:, None, None] + steps[None]).reshape(-1, 3, 2)
    faces = (nodes[..., 0] % around) * across + nodes[..., 1] % across
    return Mesh(p, faces, uv[nodes[..., 0], nodes[..., 1]], chart=np.arange(len(faces)) % 7)


def camera(size: int = 24, distance: float = 3.0) -> MeshRays:
    """A pinhole above the torus, off every axis, with differentials per pixel."""
    eye = distance * np.array([0.48, -0.6, 0.64])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    step = 2.0 / size / distance
    x, y = (np.mgrid[0:size, 0:size].reshape(2, -1)[::-1] + 0.5 - size / 2) * step
    q = forward + x[:, None] * right + y[:, None] * down
    length = np.linalg.norm(q, axis=1, keepdims=True)
    d = q / length
    dd_dx, dd_dy = (step * (axis - d * (d @ axis)[:, None]) / length for axis in (right, down))
    zero = np.zeros_like(d)
    return MeshRays(zero + eye, d, zero, zero, dd_dx, dd_dy)


def brute_force(mesh: Mesh, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest face and distance by solving every ray against every triangle in float64."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    n = np.cross(b - a, c - a)
    slope = d @ n.T
    t = (np.sum(a * n, axis=1) - o @ n.T) / np.where(slope == 0, np.inf, slope)
    p = o[:, None] + t[..., None] * d[:, None]
    sides = [np.sum(np.cross(y - x, p - x) * n, axis=-1) for x, y in ((a, b), (b, c), (c, a))]
    # Crossings on an edge belong to both faces: a rounding margin relative to the squared area keeps them.
    inside = np.all([side >= -1e-13 * np.sum(n * n, axis=1) for side in sides], axis=0)
    t = np.where(inside & (t > 0) & (slope != 0), t, np.inf)
    return np.argmin(t, axis=1), t.min(axis=1)


@pytest.fixture(scope="module")
def reference() -> MeshReference:
    return MeshReference(torus())


def test_hits_match_brute_force(reference: MeshReference) -> None:
    rng = np.random.default_rng(5)
    o = rng.normal(size=(1500, 3))
    o *= 3.0 / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-1, 1, (1500, 3)) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    face, t = brute_force(reference.mesh, o, d)
    hits = reference.first_hit(o, d)
    np.testing.assert_array_equal(hits.hit, np.isfinite(t))
    hit = hits.hit
    # Both solve one plane in float64; at slope s the distance is good to eps * 3 / s, and s > 1e-3 here.
    np.testing.assert_allclose(hits.t[hit], t[hit], rtol=0, atol=2e-12)
    assert np.mean(hits.face[hit] == face[hit]) > 0.999  # a ray through an edge may name either face
    corners = reference.mesh.vertices[reference.mesh.faces[hits.face[hit]]]
    np.testing.assert_allclose(np.einsum("nc,nck->nk", hits.barycentric[hit], corners), hits.p[hit], atol=1e-11)


def test_rays_through_edges_and_vertices_lose_nothing(reference: MeshReference) -> None:
    """Aimed at shared edges and vertices of a closed mesh, float32 picks faces that float64 does not cross."""
    mesh = reference.mesh
    a, b, _ = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    upper = (a[:, 2] > 0.15) & (b[:, 2] > 0.15)  # below lies the silhouette, where nothing is certain
    targets = np.concatenate([a[upper], (a[upper] + b[upper]) / 2])
    o = np.array([0.3, 0.2, 9.0])
    d = targets - o
    distance = np.linalg.norm(d, axis=1)
    hits = reference.first_hit(np.broadcast_to(o, d.shape), d / distance[:, None])
    assert hits.hit.all()
    # The hit is the target, or another part of the torus in front of it, which at this height there is not.
    np.testing.assert_allclose(hits.t, distance, atol=1e-12 * 9)
    assert not hits.clamped.any()


def test_distant_origins_are_as_exact(reference: MeshReference) -> None:
    o = np.array([[1e6 + 1.0, 0.05, 0.07]])
    hits = reference.first_hit(o, np.array([[-1.0, 0.0, 0.0]]))
    # float64 resolves 1e-10 at 1e6; float32 alone would be off by 0.06.
    _, near = brute_force(reference.mesh, np.array([[3.0, 0.05, 0.07]]), np.array([[-1.0, 0.0, 0.0]]))
    assert hits.p[0, 0] == pytest.approx(3.0 - near[0], abs=1e-9)


def test_uv_gradient_matches_differences(reference: MeshReference) -> None:
    facets = reference.facets
    a, b, c = np.moveaxis(facets.corners, 1, 0)
    for edge, change in ((b - a, facets.uv[:, 1] - facets.uv[:, 0]), (c - a, facets.uv[:, 2] - facets.uv[:, 0])):
        # The map is affine on a face, so the difference along an edge is exact to rounding.
        np.testing.assert_allclose(np.einsum("fkj,fj->fk", facets.uv_gradient, edge), change, atol=1e-14)
    across = np.einsum("fkj,fj->fk", facets.uv_gradient, facets.normal)
    np.testing.assert_allclose(across, 0.0, atol=1e-14 * np.abs(facets.uv_gradient).max())


def test_faces_without_area_have_no_gradient() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]])
    mesh = Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3]]), np.random.default_rng(0).random((2, 3, 2)))
    gradient = MeshReference(mesh).facets.uv_gradient
    assert np.all(gradient[0] == 0) and np.isfinite(gradient).all() and np.any(gradient[1] != 0)


def test_empty_mesh_is_refused() -> None:
    with pytest.raises(BadInput, match="needs a mesh with faces"):
        MeshReference(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)))


def _followed(reference: MeshReference, rays: MeshRays, bounces: int, normals: str, faces: list[np.ndarray]):
    """Outputs uv and d of displaced rays, nothing where a displaced ray takes other faces than the central one."""

    def outputs(dx: float, dy: float) -> np.ndarray:
        hops = reference.follow(displace(rays, dx, dy), bounces, normals)
        same = np.all([hop.face == face for hop, face in zip(hops, faces, strict=True)], axis=0)
        return np.where(same[:, None], hops[-1].uv, np.nan)

    return outputs


def _compare(reference: MeshReference, rays: MeshRays, bounces: int, normals: str) -> tuple[np.ndarray, int]:
    """Relative difference of the footprint from displaced rays, where these stay on the same faces."""
    hops = reference.follow(rays, bounces, normals)
    # Steps of a hundredth of a pixel stay within a face almost everywhere; their Taylor remainder is of order four.
    truth = richardson(_followed(reference, rays, bounces, normals, [hop.face for hop in hops]), step=0.01)
    last = hops[-1]
    good = last.hit & np.isfinite(truth.error_dx).all(axis=1) & np.isfinite(truth.error_dy).all(axis=1)
    ours = np.stack([last.duv_dx, last.duv_dy], axis=2)[good]
    theirs = np.stack([truth.d_dx, truth.d_dy], axis=2)[good]
    bar = np.linalg.norm(np.stack([truth.error_dx, truth.error_dy], axis=2)[good], axis=(1, 2))
    size = np.linalg.norm(theirs, axis=(1, 2))
    excess = np.linalg.norm(ours - theirs, axis=(1, 2)) - bar
    return np.maximum(excess, 0.0) / size, int(good.sum())


@pytest.mark.parametrize("bounces", [0, 1, 2])
@pytest.mark.parametrize("normals", NORMALS)
def test_differentials_match_displaced_rays(reference: MeshReference, bounces: int, normals: str) -> None:
    rays = camera(64)
    error, count = _compare(reference, rays, bounces, normals)
    assert count > (300, 30, 5)[bounces]
    # Beyond the truth's own error bar there is rounding: eps * |uv| / step = 2e-16 / 5e-3 against footprints of 1e-2
    # and up, times the slope's inverse at grazing hits (below 1e3).
    assert error.max() < 1e-7


@pytest.mark.parametrize("fault", ["dt_dx left out", "normal not normalised", "sign of dn"])
def test_planted_faults_are_seen(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = MeshReference(torus())
    plain = MeshReference._normal_derivative
    transfer = MeshReference.transfer
    if fault == "dt_dx left out":

        def faulty_transfer(self, rays, start=None, normals="faceted"):
            hits, at = transfer(self, rays, start, normals)
            t = np.where(hits.hit, hits.t, 0.0)[:, None]
            gradient = self.facets.uv_gradient[hits.face]
            return replace(hits, duv_dx=np.einsum("nkj,nj->nk", gradient, rays.dp_dx + t * rays.dd_dx)), at

        monkeypatch.setattr(MeshReference, "transfer", faulty_transfer)
        error, _ = _compare(reference, camera(64), 0, "area")
    else:
        factor = -1.0 if fault == "sign of dn" else 0.97
        monkeypatch.setattr(MeshReference, "_normal_derivative", lambda *given: factor * plain(*given))
        error, _ = _compare(reference, camera(64), 1, "area")
    assert np.median(error) > 1e-3


def test_reflection_keeps_the_identities(reference: MeshReference) -> None:
    rays = camera(48)
    for normals in NORMALS:
        hits, at = reference.transfer(rays, None, normals)
        out = reference.reflect(hits, at, normals)
        hit = hits.hit
        assert hit.sum() > 200
        # Unit vectors and tangents to a few roundings of numbers below 10.
        np.testing.assert_allclose(np.sum(out.d[hit] ** 2, axis=1), 1.0, atol=1e-14)
        for dd in (out.dd_dx, out.dd_dy):
            np.testing.assert_allclose(np.sum(out.d * dd, axis=1)[hit], 0.0, atol=1e-13)
        face = reference.facets.normal[hits.face]
        np.testing.assert_allclose(np.sum(face * at.dp_dx, axis=1)[hit], 0.0, atol=1e-13)


def test_secondary_rays_skip_their_own_face() -> None:
    mesh = torus()
    reference = MeshReference(mesh)
    centre = mesh.vertices[mesh.faces].mean(axis=1)
    for side in (1.0, -1.0):  # outwards and inwards, along the normal and nearly along the face
        n = side * reference.facets.normal
        edge = mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]]
        for lean in (0.0, 200.0):
            d = n + lean * edge / np.linalg.norm(edge, axis=1, keepdims=True)
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            start = np.arange(len(centre))
            hits = reference.first_hit(centre, d, start)
            assert not np.any(hits.face == start)
            if side < 0:
                assert hits.hit.all()  # from inside a closed mesh there is always a far side


def test_misses_are_clean(reference: MeshReference) -> None:
    rays = camera(8, distance=30.0)
    away = replace(rays, d=-rays.d)
    for hits in reference.follow(away, 1, "area"):
        assert not hits.hit.any() and np.all(hits.face == -1) and np.all(np.isinf(hits.t))
        for name in ("p", "n", "uv", "duv_dx", "duv_dy"):
            assert np.all(getattr(hits, name) == 0)
