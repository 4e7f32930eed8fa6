"""Scenes in pages for tests, and what must hold for all of them."""

from dataclasses import replace

import numpy as np
import warp as wp

from raybatch_addon.core.bvh.build.encode import as_vectors
from raybatch_addon.core.bvh.node import BOXES_NODE, EMPTY_CHILD, QUANTISED_NODE, Layout, aligned_empty
from raybatch_addon.core.bvh.pages.paged_scene import PagedScene
from raybatch_addon.core.bvh.pages.store import page_buffer
from raybatch_addon.core.bvh.tree import Tree
from raybatch_addon.core.scene.description import Mesh, Scene, Visibility
from raybatch_addon.core.scene.motion import instance_maps
from tests.support import scenes
from tests.twins.treelet_walk import CutBlocks


def everything() -> Scene:
    """Baked meshes of two visibilities, some of which touch, a shared mesh, a mesh that is a single triangle, long
    triangles.
    """
    ball, other = scenes.sphere("ball", 40, 20), scenes.sphere("other", 30, 16)
    shared = scenes.sphere("shared", 36, 18)
    sliver = Mesh("sliver", np.float32([[-9, -1, -1], [9, -1.1, -1], [9, -1, -0.9]]), np.int32([[0, 1, 2]]))
    tilted = scenes.translation(0, 3, 0, 0.7)
    tilted[:, :3] @= np.float32([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return scenes.scene(
        [
            (ball, scenes.IDENTITY, scenes.diffuse()),
            (shared, scenes.translation(3, 0, 0), scenes.diffuse()),
            (other, scenes.translation(0.5, 0, 0), scenes.diffuse()),
            (Mesh("twin", ball.positions.copy(), ball.triangles[::-1].copy()), scenes.IDENTITY, scenes.diffuse()),
            (shared, tilted, scenes.diffuse()),
            (scenes.plane("floor", 20.0), scenes.translation(0, 0, -1.2), scenes.diffuse()),
            (sliver, scenes.IDENTITY, scenes.diffuse()),
            (scenes.sphere("hidden", 24, 12), scenes.translation(-3, 0, 0), scenes.diffuse(), int(Visibility.CAMERA)),
        ]
    )


def strands(name: str, count: int, segments: int = 4, ribbons: bool = False, seed: int = 1) -> Mesh:
    """Strands that become thin, some of them points, all over a ball of radius 1."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, 3))
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    along = np.linspace(0, 0.4, segments + 1)
    points = root[:, None] * (1 + along[:, None]) + 0.3 * along[:, None] ** 2 * rng.normal(size=(count, 1, 3))
    i = np.arange(count * (segments + 1), dtype=np.int32).reshape(count, -1)
    rows = np.stack([i[:, :-1], i[:, 1:], i[:, :-1]], -1).reshape(-1, 3)
    rows[::50, 1] = rows[::50, 0]
    radii = np.tile(np.linspace(0.02, 0.004, segments + 1, dtype=np.float32), count)
    return Mesh(name, points.reshape(-1, 3).astype(np.float32), rows, radii=radii, ribbons=ribbons)


def hairy() -> Scene:
    """`everything` with hair: baked among triangles, ribbons, and a mesh of points and strands that is placed twice."""
    made = everything()
    tuft = strands("tuft", 150, seed=2)
    objects = [
        (made.meshes[mesh], transform, scenes.diffuse(), int(visibility))
        for mesh, transform, visibility in zip(
            made.instances.mesh, made.instances.transform, made.instances.visibility, strict=True
        )
    ]
    return scenes.scene(
        [
            *objects,
            (strands("hair", 500), scenes.IDENTITY, scenes.diffuse()),
            (strands("flat", 200, ribbons=True, seed=3), scenes.translation(-2.5, 0, 0.5), scenes.diffuse()),
            (tuft, scenes.translation(0, -3, 0), scenes.diffuse()),
            (tuft, scenes.translation(1, 3, 1, 0.6), scenes.diffuse()),
        ]
    )


def swaying(mesh: Mesh) -> Mesh:
    """The mesh, deforming from one step to the next two."""
    sway = 0.15 * np.sin(5 * mesh.positions[:, [1, 2, 0]])
    return replace(
        mesh, motion=np.stack([mesh.positions + share * sway for share in (-1.0, 0.0, 1.5)]).astype(np.float32)
    )


def turning(made: Scene, which: tuple[int, ...]) -> Scene:
    """The scene, in which the instances `which` turn and rise."""
    maps = np.repeat(made.instances.transform[:, None], 3, 1)
    for step, angle in enumerate((0.0, 0.4, 1.1)):
        turn = np.float32([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        for i in which:
            maps[i, step, :, :3] = turn @ maps[i, 0, :, :3]
            maps[i, step, 2, 3] += 0.3 * step
    return replace(made, instances=replace(made.instances, transform=maps[:, 1], motion=instance_maps(maps)))


def living() -> Scene:
    """`hairy`, where a mesh turns, one that is placed twice moves in one place, and a ball and two tufts deform."""
    made = hairy()
    deforming = made.instances.mesh[[0, 8, 10]]
    meshes = (swaying(mesh) if i in deforming else mesh for i, mesh in enumerate(made.meshes))
    return turning(replace(made, meshes=tuple(meshes)), (1, 2, 9, 11))


def page_bytes(paged: PagedScene) -> list[np.ndarray]:
    """The contents of every page as it lies on the device."""
    pages = []
    for number, page in enumerate(paged.pages):
        buffer = page_buffer(page.byte_count)
        paged.store.read_into(page, buffer.numpy(), direct=True)
        if paged.encoded:
            target = wp.zeros(page.device_bytes, dtype=wp.uint8, device="cpu")
            paged.expand(number, buffer, target)
            buffer = target
        pages.append(buffer.numpy())
    return pages


def blocks(paged: PagedScene) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Words of the nodes and of the triangles of every treelet."""
    node_words, triangle_words = paged.layout.node_words, paged.layout.triangle_words
    pages, resident = page_bytes(paged), paged.resident_nodes.numpy().reshape(-1)
    units = block_sizes(paged)
    nodes, triangles = [], []
    for k, page in enumerate(paged.treelet_page):
        source = resident if paged.nodes_resident else pages[page]
        start = paged.treelet_node_byte[k]
        nodes.append(
            source[start : start + 4 * node_words * units[k][0]].view(paged.layout.node_type).reshape(-1, node_words)
        )
        start = paged.treelet_triangle_byte[k]
        triangles.append(
            pages[page][start : start + 4 * triangle_words * units[k][1]].view(np.float32).reshape(-1, triangle_words)
        )
    return nodes, triangles


def block_sizes(paged: PagedScene) -> list[tuple[int, int]]:
    """Nodes and units of triangles below each treelet's root, found by following its children."""
    sizes = []
    pages, resident = page_bytes(paged), paged.resident_nodes.numpy().reshape(-1)
    layout, words = paged.layout, paged.layout.node_words
    top = paged.tree.nodes.numpy().view(layout.node_type).reshape(-1, words)
    for k, page in enumerate(paged.treelet_page):
        source = (resident if paged.nodes_resident else pages[page])[paged.treelet_node_byte[k] :]
        source = source[: len(source) // (4 * words) * 4 * words].view(layout.node_type).reshape(-1, words)
        found, units, level = 0, 0, top[paged.root.numpy()[k]][None]
        while len(level):
            if layout is Layout.BOXES:
                child = level.view(BOXES_NODE)[:, 0]["child"]
                inner = child[(child >= 0) & (child != EMPTY_CHILD)]
                leaf = ~child[child < 0]
                units = max(units, int(((leaf >> 3) + (leaf & 7) + 1).max(initial=0)))
            else:
                fields = level.view(QUANTISED_NODE)[:, 0]
                count = np.unpackbits(fields["inner_mask"][:, None], axis=1).sum(1).astype(int)
                inner = np.concatenate(
                    [np.arange(a, a + n) for a, n in zip(fields["child_base"], count)] + [np.zeros(0, int)]
                )
                leaf = (fields["meta"] != 0) & (fields["meta"] & 0xF8 != 0x38)
                end = (
                    fields["triangle_base"][:, None]
                    + (fields["meta"] & 31)
                    + np.array([0, 1, 0, 2, 0, 0, 0, 3])[fields["meta"] >> 5]
                )
                units = max(units, int(end[leaf].max(initial=0)))
            found = max(found, int(inner.max(initial=-1)) + 1)
            level = source[inner]
        sizes.append((found, units))
    return sizes


def cut_blocks(paged: PagedScene) -> list[CutBlocks]:
    """The tree of every chunk."""
    layout, tree = paged.layout, paged.tree
    nodes, triangles = blocks(paged)
    top = tree.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)[: tree.top_node]
    top_triangles = (
        tree.triangles.numpy().reshape(-1, layout.triangle_words)
        if tree.triangles.size > 1
        else np.zeros((0, layout.triangle_words), np.float32)
    )
    starts = np.unique(np.stack([tree.entry_node.numpy(), tree.entry_triangle.numpy()]), axis=1)
    ends = np.append(starts[:, 1:], [[len(top)], [len(top_triangles)]], axis=1)
    found = []
    for (node, triangle), (node_end, triangle_end) in zip(starts.T, ends.T):
        of_node = paged.of_node.numpy()[node:node_end]
        own = np.sort(of_node[of_node >= 0])
        assert np.array_equal(own, np.arange(own[0], own[0] + len(own)))
        found.append(
            CutBlocks(
                top[node:node_end],
                np.where(of_node >= 0, of_node - own[0], -1).astype(np.int32),
                [nodes[k] for k in own],
                [triangles[k] for k in own],
                top_triangles[triangle:triangle_end],
            )
        )
    return found


def whole_tree(paged: PagedScene) -> Tree:
    """The scene in memory, uncut; every chunk must be one treelet."""
    layout, source = paged.layout, paged.tree
    chunks = cut_blocks(paged)
    assert all(len(chunk.top_nodes) == 1 and len(chunk.nodes) == 1 for chunk in chunks)
    mesh_nodes = []
    for chunk in chunks:
        words = np.concatenate([chunk.top_nodes, chunk.nodes[0]])
        if layout is Layout.BOXES:
            child = words.view(BOXES_NODE)[:, 0]["child"]
            child[(child >= 0) & (child != EMPTY_CHILD)] += 1
        else:
            words.view(QUANTISED_NODE)[:, 0]["child_base"] += 1
        mesh_nodes.append(words)
    top = source.nodes.numpy().view(layout.node_type).reshape(-1, layout.node_words)[source.top_node :]
    node_first = np.cumsum([0, *(len(words) for words in mesh_nodes)])
    triangle_first = np.cumsum([0, *(len(chunk.triangles[0]) for chunk in chunks)])
    tree = Tree()
    for name, parts in (("nodes", [*mesh_nodes, top]), ("triangles", [chunk.triangles[0] for chunk in chunks])):
        words = np.concatenate(parts)
        memory = aligned_empty(words.shape, words.dtype)
        memory[:] = words
        setattr(tree, name, as_vectors(memory))
    place = np.searchsorted(np.unique(source.entry_node.numpy()), source.entry_node.numpy())
    tree.entry_node = wp.array(node_first[place].astype(np.int32), dtype=int, device="cpu")
    tree.entry_triangle = wp.array(triangle_first[place].astype(np.int32), dtype=int, device="cpu")
    for name in (
        "entry_centre",
        "entry_from_world",
        "entry_instance",
        "entry_visibility",
        "merged_first",
        "merged_instance",
        "merged_triangle_first",
        "top_entry",
        "top_centre",
        "top_margin",
        "entry_count",
    ):
        setattr(tree, name, getattr(source, name))
    tree.top_node = int(node_first[-1])
    return tree
