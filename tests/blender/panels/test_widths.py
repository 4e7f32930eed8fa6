"""Nothing is cut off where the Properties editor has its first width: in panels of renders and of the other tabs."""

from types import SimpleNamespace

import pytest

bpy = pytest.importorskip("bpy")

from raybatch_addon.blender import missing, reports
from raybatch_addon.blender.cluster.command import CommandError
from raybatch_addon.convergence.records import FINISHED, store
from raybatch_addon.core.scene.notice import Notice, Weight
from raybatch_addon.core.settings.settings import RenderSettings
from raybatch_addon.ui.cluster import panel as cluster_panel
from raybatch_addon.ui.cluster import running
from raybatch_addon.ui.compare import panel as compare_panel
from raybatch_addon.ui.compare.slots import SlotRender
from tests.support.panel_layout import FIRST_WIDTH, INNER_WIDTH, Measured, context_of, own_panels

LONG = "an object whose name is as long as Blender lets it be, 63 bytes"


def panels_of(name, context):
    """The panel `name`, and those that lie in it, as far as `context` has them."""
    found = [each for each in own_panels() if name in (each.__name__, getattr(each, "bl_parent_id", ""))]
    return [each for each in found if each.poll(context)]


def measured(scene, name, **extra):
    """The layouts of the panel `name` and of those in it, at the first width."""
    region = SimpleNamespace(width=FIRST_WIDTH, as_pointer=lambda: 1)
    context = context_of(scene, region=region, **extra)
    layouts = []
    for panel in panels_of(name, context):
        layouts.append(Measured(INNER_WIDTH, is_split=False))
        panel.draw(SimpleNamespace(layout=layouts[-1], group=getattr(panel, "group", None)), context)
    assert layouts
    return layouts


def cut(scene, name, **extra):
    return [text for layout in measured(scene, name, **extra) for text in layout.cut]


def labels(scene, name, **extra):
    return [note[1] for layout in measured(scene, name, **extra) for note in layout.notes if note[0] == "label"]


@pytest.fixture
def runs(scene):
    """Records of renders that differ in many settings."""
    store.clear()
    for sequence in ("SOBOL", "BLUE_NOISE", "INDEPENDENT"):
        settings = RenderSettings(sample_sequence=sequence, pixel_filter="BOX" if sequence == "SOBOL" else "GAUSSIAN")
        run = store.begin(scene.name, "ViewLayer", 1, settings)
        store.change(run.number, state=FINISHED, seconds=1234.5)
    yield store.runs()
    store.clear()


def test_rows_of_convergence_fit_and_names_are_whole(scene, runs):
    name = "RAYBATCH_RENDER_PT_convergence"
    assert cut(scene, name) == []
    said = " ".join(labels(scene, name))
    for text in ("Sequence Blue Noise", "Pixel Filter Box"):
        assert text in said
    assert [text for text in labels(scene, name) if text.startswith("#")] == [f"#{run.number}" for run in runs]


def test_convergence_fits_before_a_render(scene):
    store.clear()
    for is_on in (False, True):
        scene.raybatch_convergence.record = is_on
        assert cut(scene, "RAYBATCH_RENDER_PT_convergence") == []


def test_compare_fits(scene, monkeypatch):
    name = "RAYBATCH_RENDER_PT_compare"
    assert cut(scene, name) == []
    title = "1234.5 s, 4,096 samples per pixel, error 0.00123 (relMSE) at 4,000, stopped by its noise threshold, cuda:0"
    newest = vars(RenderSettings())
    older = vars(RenderSettings(sample_sequence="BLUE_NOISE", geometry_budget=123_456_789, texture_filter="FOOTPRINT"))
    found = [(7, SlotRender(2, title, newest)), (0, SlotRender(1, title, older))]
    monkeypatch.setattr(compare_panel, "slots", lambda: SimpleNamespace(active_index=0))
    monkeypatch.setattr(compare_panel, "known_renders", lambda: found)
    assert cut(scene, name) == []
    assert "Texture Filter Footprint" in " ".join(labels(scene, name))


@pytest.mark.parametrize("objects", [[], ["Cube"], [LONG], [LONG, LONG]])
def test_before_the_render_fits(scene, monkeypatch, objects):
    name = "RAYBATCH_RENDER_PT_before_render"
    notice = Notice(f"“{LONG}” has what is not there", Weight.MISSING, objects=objects, remedy=f"replace “{LONG}”")
    for found in (None, [], [notice] * 30):
        monkeypatch.setattr(missing, "found_in", lambda _scene, found=found: found)
        for value in scene.raybatch_export.bl_rna.properties["strict"].enum_items.keys():
            scene.raybatch_export.strict = value
            assert cut(scene, name) == []


@pytest.fixture
def no_job(monkeypatch):
    monkeypatch.setattr(running, "current", None)


def test_the_cluster_fits(scene, monkeypatch, no_job):
    name = "RAYBATCH_RENDER_PT_cluster"
    assert cut(scene, name) == [], "nothing is known of a cluster"
    message = "Frame 4, 2 of 400: 1,234.0 of 4,096 samples, 1234.56 Mrays/s, 12:34 left"
    process = SimpleNamespace(
        is_running=True, is_stopped=False, message=message, fraction=0.5, saved=["a"] * 12, warnings=[LONG] * 3
    )
    job = SimpleNamespace(process=process, error=f"the scheduler at tcp://{LONG} is not there", scene=LONG)
    monkeypatch.setattr(running, "process_running", lambda: process)
    assert cut(scene, name) == [], "it renders"
    monkeypatch.setattr(running, "process_running", lambda: None)
    monkeypatch.setattr(running, "current", job)
    for process.is_stopped in (False, True):
        assert cut(scene, name) == [], "it rendered"
    environment = SimpleNamespace(command=list, where=lambda: "local:2")
    monkeypatch.setattr(cluster_panel, "named_environment", lambda: environment)
    assert cut(scene, name) == []
    environment.where = lambda: (_ for _ in ()).throw(CommandError(f"{LONG} names no cluster"))
    assert cut(scene, name) == []


def test_the_checkpoint_fits(scene, tmp_path):
    scene.render.filepath = str(tmp_path / LONG / "frame")
    for scene.raybatch_checkpoint.use in (False, True):
        assert cut(scene, "RAYBATCH_RENDER_PT_checkpoint") == []


def test_the_viewport_motion_blur_and_curves_fit(scene):
    for name in ("viewport", "motion_blur", "curves"):
        assert cut(scene, f"RAYBATCH_RENDER_PT_{name}") == []
    scene.cycles.rolling_shutter_type = "TOP"
    for shape in scene.cycles_curves.bl_rna.properties["shape"].enum_items.keys():
        scene.cycles_curves.shape = shape
        assert cut(scene, "RAYBATCH_RENDER_PT_curves") + cut(scene, "RAYBATCH_RENDER_PT_motion_blur") == []


def every_choice(owner, name):
    """Set an enumeration to each of its choices in turn."""
    for choice in owner.bl_rna.properties[name].enum_items.keys():
        setattr(owner, name, choice)
        yield choice


def test_panels_of_materials_fit(scene):
    material = bpy.data.materials.new("Material")
    context = {"material": material}
    for _ in every_choice(material, "displacement_method"):
        assert cut(scene, "RAYBATCH_MATERIAL_PT_settings", **context) == []
    for _ in every_choice(material.cycles, "emission_sampling"):
        assert cut(scene, "RAYBATCH_MATERIAL_PT_settings", **context) == []


@pytest.mark.parametrize("kind", ["POINT", "SUN", "SPOT", "AREA"])
@pytest.mark.parametrize("is_portal", [False, True])
def test_panels_of_lights_fit(scene, kind, is_portal):
    light = bpy.data.lights.new("Light", kind)
    light.cycles.is_portal = is_portal
    assert cut(scene, "RAYBATCH_LIGHT_PT_settings", light=light) == []
    if kind != "AREA" or not is_portal:
        assert cut(scene, "RAYBATCH_LIGHT_PT_nodes", light=light) == []


def test_panels_of_worlds_fit(scene):
    world = bpy.data.worlds.new("World")
    for name in ("ray_visibility", "ambient_occlusion", "light_group"):
        assert cut(scene, f"RAYBATCH_WORLD_PT_{name}", world=world) == []
    for _ in every_choice(world.cycles, "sampling_method"):
        assert cut(scene, "RAYBATCH_WORLD_PT_settings", world=world) == []


def test_panels_of_cameras_fit(scene):
    camera = bpy.data.cameras.new("Camera")
    camera.type = "PANO"
    owner = camera if hasattr(camera, "panorama_type") else camera.cycles
    for _ in every_choice(owner, "panorama_type"):
        assert cut(scene, "RAYBATCH_CAMERA_PT_panorama", camera=camera) == []


@pytest.mark.parametrize("kind", ["mesh", "camera", "light"])
def test_panels_of_objects_fit(scene, kind):
    data = {
        "mesh": lambda: bpy.data.meshes.new("Mesh"),
        "camera": lambda: bpy.data.cameras.new("Camera"),
        "light": lambda: bpy.data.lights.new("Light", "POINT"),
    }[kind]()
    context = {"object": bpy.data.objects.new("Object", data)}
    names = (
        ["motion_blur", "light_group"]
        + ["ray_visibility"] * (kind != "camera")
        + ["shadow_terminator"] * (kind == "mesh")
    )
    for scene.render.use_motion_blur in (False, True):
        for name in names:
            assert cut(scene, f"RAYBATCH_OBJECT_PT_{name}", **context) == []


def test_panels_of_view_layers_fit(scene):
    scene.view_layers[0].use_pass_ambient_occlusion = True
    scene.world = bpy.data.worlds.new("World")
    for name in ("passes", "filter"):
        assert cut(scene, f"RAYBATCH_VIEWLAYER_PT_{name}") == []


def test_groups_of_settings_fit_with_their_reasons(scene):
    reports.clear()
    own = scene.raybatch
    for own.device, own.batching, own.error_estimate, own.nee in (
        ("cpu", "REFERENCE", "OFF", "OFF"),
        ("cuda:0", "OFF", "ON", "HALF"),
        ("AUTO", "AUTO", "ON", "ON"),
    ):
        for panel in own_panels():
            if hasattr(panel, "group") and panel.group != "DEVICE":
                assert cut(scene, panel.__name__) == [], panel.__name__
