"""Pages that a device makes hold the same bytes as those that the host makes of the same trees."""

import numpy as np
import pytest
import warp as wp

from raybatch_addon.core.bvh.node import Layout, triangle_faces
from raybatch_addon.core.bvh.pages.cuda.chunks import build_chunk, in_treelets, one_treelet, retyped
from raybatch_addon.core.bvh.pages.cuda.encode import encode_on_device
from raybatch_addon.core.bvh.pages.divide.cells import mesh_from, mesh_triangles
from raybatch_addon.core.bvh.pages.encode import encode_triangles
from raybatch_addon.core.bvh.treelets.cut import CutRule, cut_nodes
from tests.support import wide_trees

MESHES = {
    "sphere": wide_trees.sphere(40),
    "soup": wide_trees.soup(1000),
    **{str(count): wide_trees.soup(count) for count in (1, 2, 3, 4, 7, 63, 64, 129)},
}


def tree_of(name: str, device: str):
    """The tree of the upper half of a mesh, and the mesh."""
    positions, triangles = MESHES[name]
    faces = np.arange(len(triangles) // 2, len(triangles), dtype=np.int32)
    numbers = wp.array(np.arange(3 * len(faces)).reshape(-1, 3), dtype=wp.vec3i, device=device)
    return build_chunk(mesh_triangles(positions, triangles, wp.get_device(device)), faces, numbers)


def host_words(array, words: int, dtype) -> np.ndarray:
    """Words of nodes or triangles, wherever they lie."""
    return (array.numpy() if isinstance(array, wp.array) else array).reshape(-1).view(dtype).reshape(-1, words)


@pytest.mark.parametrize("rule", [CutRule(), CutRule(size=3), CutRule(top_bytes_max=3000), CutRule(size=1)], ids=str)
@pytest.mark.parametrize("name", MESHES)
def test_chunks_are_cut_as_on_the_host(name, rule, device):
    tree = tree_of(name, device)
    nodes, blocks = host_words(tree.nodes, 20, np.uint32), host_words(tree.triangles, 12, np.uint32)
    cut = cut_nodes(Layout.QUANTISED, nodes, rule)
    made = [in_treelets(tree, cut)] + ([one_treelet(tree)] if rule.cuts_nothing else [])
    assert rule.cuts_nothing == (rule == CutRule())
    _, triangles = MESHES[name]
    for chunk in made:
        for field in ("top_nodes", "top_treelet", "treelet_root", "node_first", "levels"):
            assert np.array_equal(getattr(chunk, field), getattr(cut, field)), field
        assert np.array_equal(chunk.triangle_first, cut.triangle_first - cut.top_triangle_count)
        assert np.array_equal(host_words(chunk.nodes, 20, np.uint32), cut.nodes)
        ordered, top = blocks[cut.triangle_order], cut.top_triangle_count
        assert np.array_equal(host_words(chunk.top_triangles, 12, np.uint32), ordered[:top])
        assert np.array_equal(host_words(chunk.triangles, 12, np.uint32), ordered[top:])
        faces = triangle_faces(Layout.QUANTISED, ordered[top:].view(np.float32))
        assert np.array_equal(chunk.vertices.numpy().reshape(-1, 3), triangles[faces])


@pytest.mark.parametrize("name", MESHES)
def test_numbers_and_corners_are_those_of_the_mesh(name, device):
    tree = tree_of(name, device)
    positions, triangles = MESHES[name]
    blocks = host_words(tree.triangles, 12, np.float32)
    faces = triangle_faces(Layout.QUANTISED, blocks)
    assert np.array_equal(np.sort(faces), tree.faces)
    assert np.array_equal(blocks.reshape(-1, 3, 4)[:, :, :3], positions[triangles[faces]])


def test_a_mesh_behind_others_has_numbers_of_its_own(device):
    positions, triangles = MESHES["soup"]
    numbers = wp.array(np.arange(300).reshape(-1, 3), dtype=wp.vec3i, device=device)
    every = mesh_triangles(positions, triangles, wp.get_device(device))
    tree = build_chunk(mesh_from(every, 300), np.arange(100, dtype=np.int32), numbers)
    blocks = host_words(tree.triangles, 12, np.float32)
    faces = triangle_faces(Layout.QUANTISED, blocks)
    assert np.array_equal(blocks.reshape(-1, 3, 4)[:, :, :3], positions[triangles[300 + faces]])
    assert np.array_equal(tree.vertices.numpy().reshape(-1, 3), triangles[300 + faces])


@pytest.mark.parametrize("spread", [0, 2**24 - 1, 2**24, 2**31 - 1])
@pytest.mark.parametrize("name", MESHES)
def test_triangles_are_packed_to_the_words_of_the_host(name, spread, device):
    tree = tree_of(name, device)
    positions, triangles = MESHES[name]
    blocks = host_words(tree.triangles, 12, np.float32).copy()
    faces = triangle_faces(Layout.QUANTISED, blocks)
    corners = triangles[faces]
    if spread:
        faces[:] = np.random.default_rng(1).integers(0, spread, len(faces), endpoint=True)
        faces[1:3] = [0, spread][: len(faces[1:3])]
    words = wp.array(blocks.view(np.int32).reshape(-1), dtype=int, device=device)
    found = encode_on_device(words, wp.array(corners.reshape(-1), dtype=int, device=device))
    assert np.array_equal(found.numpy().view(np.uint32), encode_triangles(blocks, corners, positions))


def test_nothing_is_packed_too(device):
    none = wp.empty(0, dtype=int, device=device)
    expected = encode_triangles(np.zeros((0, 12), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32))
    assert np.array_equal(encode_on_device(none, none).numpy().view(np.uint32), expected)


def test_memory_is_seen_as_other_elements(device):
    vectors = wp.array(np.arange(8, dtype=np.float32).reshape(-1, 4), dtype=wp.vec4, device=device)
    assert retyped(vectors, wp.uint8).size == 32 and np.array_equal(retyped(vectors, wp.float32).numpy(), np.arange(8))
