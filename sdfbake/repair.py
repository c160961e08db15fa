"""Mends what is harmless to mend, and finds faces that cross each other, with pymeshlab.

In: a mesh. Out: a mesh without duplicate or degenerate faces and unused vertices, coherently oriented, and the list of
what was done. Texture coordinates, charts and parts stay with their corners and faces: original face and vertex ids
travel through pymeshlab as scalars.
"""

from typing import Any

import numpy as np

from sdfbake.diagnosis import Diagnosis, Finding, diagnose
from sdfbake.mesh import Mesh
from sdfbake.meshfile import weld
from sdfbake.topology import Topology


def repair(mesh: Mesh, diagnosis: Diagnosis | None = None) -> tuple[Mesh, list[str]]:
    """Repair a mesh as far as it is harmless.

    Parameters
    ----------
    mesh
        Any mesh that is not empty and finite.
    diagnosis
        What `diagnose` said of it, if it was asked already.

    Returns
    -------
    mesh, done
        The mesh (the very same if there was nothing to do), and one sentence per thing done.
    """
    diagnosis = diagnosis or diagnose(mesh)
    if not diagnosis.repairable or diagnosis.has("empty") or diagnosis.has("non-finite"):
        return mesh, []
    mended = _filtered(mesh, null_faces=True)
    if _open_edges(mended) > _open_edges(mesh):
        # A face without area can still close the gap between its neighbours: then it stays.
        mended = _filtered(mesh, null_faces=False)
    done = [
        sentence
        for sentence, count in (
            ("{} unused or duplicate vertices removed", len(mesh.vertices) - len(mended.vertices)),
            ("{} degenerate or duplicate faces removed", len(mesh.faces) - len(mended.faces)),
        )
        if count > 0
        for sentence in [sentence.format(count)]
    ]
    after = diagnose(mended)
    if diagnosis.has("flipped") and not after.has("flipped"):
        done.append("faces oriented coherently")
    if after.has("inside-out"):
        mended = _turned(mended)
        done.append("the whole surface turned inside out")
    return mended, done


def crossings(mesh: Mesh) -> tuple[Finding, ...]:
    """Return the finding of self-intersecting faces, or nothing."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=mesh.vertices, face_matrix=mesh.faces))
    meshes.apply_filter("compute_selection_by_self_intersections_per_face")
    crossing = np.flatnonzero(meshes.current_mesh().face_selection_array())
    if len(crossing) == 0:
        return ()
    x, y, z = mesh.vertices[mesh.faces[crossing[0]]].mean(axis=0)
    return (Finding("self-intersecting", len(crossing), "faces", (float(x), float(y), float(z)), "noted"),)


def _filtered(mesh: Mesh, *, null_faces: bool) -> Mesh:
    """Run the filters and bring everything back to its faces and corners."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(
        pymeshlab.Mesh(
            vertex_matrix=mesh.vertices,
            face_matrix=mesh.faces,
            v_scalar_array=np.arange(len(mesh.vertices), dtype=np.float64),
            f_scalar_array=np.arange(len(mesh.faces), dtype=np.float64),
        )
    )
    meshes.apply_filter("meshing_remove_duplicate_vertices")
    meshes.apply_filter("meshing_remove_duplicate_faces")
    if null_faces:
        meshes.apply_filter("meshing_remove_null_faces")
    meshes.apply_filter("meshing_remove_unreferenced_vertices")
    # pymeshlab can orient only surfaces with at most two faces at an edge.
    if len(Topology.of(meshes.current_mesh().face_matrix().astype(np.int64)).crowded_edges) == 0:
        meshes.apply_filter("meshing_re_orient_faces_coherently")
    return _returned(mesh, meshes.current_mesh())


def _returned(mesh: Mesh, result: Any) -> Mesh:
    """Give pymeshlab's faces their corners' texture coordinates, their charts and their parts back."""
    _, place = weld(mesh.vertices)
    # Of duplicate faces pymeshlab keeps any one: the first is the one that counts.
    _, first, group = np.unique(np.sort(place[mesh.faces], axis=1), axis=0, return_index=True, return_inverse=True)
    face = first[group.reshape(-1)][np.rint(result.face_scalar_array()).astype(np.int64)]
    vertex = np.rint(result.vertex_scalar_array()).astype(np.int64)
    order = np.argsort(face, kind="stable")
    face, faces = face[order], np.asarray(result.face_matrix(), np.int64)[order]
    uv = None
    if mesh.uv is not None:
        # Every corner of the new face is found in the original one by position.
        same = place[vertex[faces]][:, :, None] == place[mesh.faces[face]][:, None, :]
        uv = np.take_along_axis(mesh.uv[face], same.argmax(axis=2)[:, :, None], axis=1)
    return mesh.with_(vertices=mesh.vertices[vertex], faces=faces, uv=uv, chart=mesh.chart[face], part=mesh.part[face])


def _open_edges(mesh: Mesh) -> int:
    return sum(finding.count for finding in diagnose(mesh).findings if finding.name == "open")


def _turned(mesh: Mesh) -> Mesh:
    """Return the mesh with every face looking the other way."""
    uv = None if mesh.uv is None else mesh.uv[:, ::-1]
    return mesh.with_(faces=mesh.faces[:, ::-1], uv=uv)
