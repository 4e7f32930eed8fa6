"""scripts/render.py where there is no Blender: what it writes, and what it says when it cannot."""

import json
import os
import re
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import render
from lib.geometry_files import SKY_RADIANCE, load_geometry
from lib.output import json_text, numbered
from PIL import Image
from rendering.pictures import HEAT_COLORS, display_pixels, heat_pixels
from rendering.standalone import resized

from raybatch_addon.core.scene.archive import load_scene, save_scene
from raybatch_addon.core.scene.passes import DEPTH_OF_NOTHING
from raybatch_addon.core.settings.presets import PRESETS, preset_settings
from raybatch_addon.core.settings.settings import SETTINGS, RenderSettings
from tests.support.command_line import HIDE_BPY, error_line, run_script

SMALL = ("--device", "cpu", "--set", "resolution=16x12", "--set", "sample_count=2")
CAMERA = "--camera=0,-4,0,0,0,0,40"  # looks along +y; the sheet fills the lower half


@pytest.fixture
def sheet(tmp_path) -> Path:
    """Two triangles that cover what is below the horizon."""
    v = np.array([[-9, 0, 0], [9, 0, 0], [9, 0, -9], [-9, 0, -9]], np.float32)
    path = tmp_path / "sheet.npz"
    np.savez(path, v=v, f=np.array([[0, 1, 2], [0, 2, 3]], np.int32), m=np.array([0, 1], np.int16))
    return path


def listing(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def test_geometry_renders_where_there_is_no_blender(sheet, tmp_path):
    out, film = tmp_path / "new/folder/out.png", tmp_path / "film.npz"
    done = run_script("render.py", sheet, "-o", out, "--film", film, "--json", "-", CAMERA, *SMALL, before=HIDE_BPY)
    assert done.returncode == 0, done.stderr
    statistics = json.loads(done.stdout)
    assert statistics["frame"]["width"] == 16 and statistics["settings"]["sample_count"] == 2
    assert statistics["invalid_samples"] == 0 and statistics["samples"] == 16 * 12 * 2
    assert "blender" not in statistics["versions"]

    with np.load(film) as passes:
        assert passes.files == ["Combined"]
        combined = passes["Combined"]
    assert combined.shape == (12, 16, 4) and combined.dtype == np.float32
    assert combined[-1, :, :3] == pytest.approx(np.broadcast_to(SKY_RADIANCE, (16, 3)), rel=1e-6)  # the top row is sky
    assert (np.abs(combined[0, :, :3] - SKY_RADIANCE) > 0.02).any(-1).all()  # the bottom row is not

    picture = np.array(Image.open(out))
    assert picture.shape == (12, 16, 3)
    assert (picture == display_pixels(combined)[..., :3]).all()


def test_blenders_files_say_what_they_need(tmp_path):
    (tmp_path / "a.blend").write_bytes(b"BLENDER")
    line = error_line(run_script("render.py", tmp_path / "a.blend", "-o", tmp_path / "x.png", before=HIDE_BPY))
    assert "needs Blender's Python module bpy" in line


def test_a_saved_scene_renders_to_the_same_film(sheet, tmp_path):
    saved, films = tmp_path / "s.scene.npz", (tmp_path / "a.npz", tmp_path / "b.npz")
    assert (
        render.main(
            [str(sheet), "--film", str(films[0]), "--save-scene", str(saved), CAMERA, "--set", "seed=5", *SMALL]
        )
        == 0
    )
    assert load_scene(saved)[1].seed == 5
    assert render.main([str(saved), "--film", str(films[1]), "--device", "cpu"]) == 0
    with np.load(films[0]) as a, np.load(films[1]) as b:
        assert a.files == b.files
        assert all(a[name].tobytes() == b[name].tobytes() for name in a.files)


def test_saving_alone_renders_nothing(sheet, tmp_path, monkeypatch):
    from raybatch_addon.core.session import Session

    monkeypatch.setattr(Session, "render", lambda *_, **__: pytest.fail("rendered"))
    assert render.main([str(sheet), "--save-scene", str(tmp_path / "s.scene.npz")]) == 0
    assert load_scene(tmp_path / "s.scene.npz")[0].frame.width == 960


def test_exr_holds_linear_values_top_row_first(sheet, tmp_path):
    out, film = tmp_path / "out.exr", tmp_path / "film.npz"
    assert render.main([str(sheet), "-o", str(out), "--film", str(film), CAMERA, *SMALL]) == 0
    with OpenEXR.File(str(out), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    with np.load(film) as passes:
        for k, letter in enumerate("RGBA"):
            assert (channels[letter] == passes["Combined"][::-1, :, k]).all()


def test_exr_holds_every_channel_of_mattes_and_the_names_they_stand_for(sheet, tmp_path):
    out, film = tmp_path / "out.exr", tmp_path / "film.npz"
    asked = ["--passes", "CryptoObject00,Diffuse Color,Depth"]
    assert render.main([str(sheet), "-o", str(out), "--film", str(film), CAMERA, *SMALL, *asked]) == 0
    with OpenEXR.File(str(out), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
        header = dict(file.header())
    with np.load(film) as passes:
        for name, letters in (("CryptoObject00", "rgba"), ("Diffuse Color", "RGB"), ("Depth", "Z")):
            for k, letter in enumerate(letters):
                assert (channels[f"{name}.{letter}"] == passes[name][::-1, :, k]).all()
    reported = {key.rsplit("/", 1)[1]: value for key, value in header.items() if key.startswith("cryptomatte/")}
    assert (
        reported["name"] == "CryptoObject"
        and reported["hash"] == "MurmurHash3_32"
        and reported["manifest"].startswith("{")
    )


def test_up_is_the_axis_that_the_caller_says(sheet, tmp_path):
    """A scene turned from z up to y up looks the same."""
    turned = tmp_path / "turned.npz"
    with np.load(sheet) as arrays:
        np.savez(turned, v=arrays["v"][:, [0, 2, 1]] * np.array([1, 1, -1], np.float32), f=arrays["f"], m=arrays["m"])
    films = []
    for path, camera, up in ((sheet, CAMERA, "z"), (turned, "--camera=0,0,4,0,0,0,40", "y")):
        films.append(tmp_path / f"{up}.npz")
        assert render.main([str(path), "--film", str(films[-1]), camera, "--up", up, *SMALL]) == 0
    with np.load(films[0]) as a, np.load(films[1]) as b:
        assert a["Combined"] == pytest.approx(b["Combined"], rel=0.2, abs=0.05)
        assert (np.abs(a["Combined"][0, :, :3] - SKY_RADIANCE) > 0.02).any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{sheet}"], "nothing would be written"),
        (["-o", "x.png"], "name the FILE"),
        (["{sheet}", "-o", "{folder}/x.png", "--set", "samples=3"], "no setting is called 'samples'"),
        (["{sheet}", "-o", "{folder}/x.png", "--set", "sample_count"], "has no value"),
        (["{sheet}", "-o", "{folder}/x.png", "--set", "bounce_max=-1"], "bounce_max.*0 to 100000"),
        (["{sheet}", "-o", "{folder}/x.png", "--set", "nee=maybe"], "nee.*one of ON, OFF, HALF"),
        (
            ["{sheet}", "-o", "{folder}/x.png", "--set", "geometry_budget=lots"],
            "geometry_budget = 'lots'.*1.5G is 1,500,000,000",
        ),
        (
            ["{sheet}", "-o", "{folder}/x.png", "--set", "block_size=40"],
            "block_size = '40'.*0, or 32 to 1024 in steps of 32",
        ),
        (
            ["{sheet}", "-o", "{folder}/x.png", "--set", "treelet_size=9", "--set", "treelet_size_min=10"],
            r"treelet_size_min \(10\) is above",
        ),
        (
            ["{sheet}", "-o", "{folder}/x.png", "--preset", "unbatched", "--set", "geometry_budget=1G"],
            "batching is OFF.*set geometry_budget to 0",
        ),
        (
            ["{sheet}", "-o", "{folder}/x.png", "--preset", "fast"],
            "no preset is called 'fast'; the presets are PREVIEW, BALANCED, FINAL, AUTO, THESIS, UNBATCHED",
        ),
        (["{sheet}", "-o", "{folder}/x.png", "--set", "resolution=0x9"], "resolution"),
        (["{sheet}", "-o", "{folder}/x.png", "--set", "resolution=9"], "WIDTHxHEIGHT"),
        (["{sheet}", "-o", "{folder}/x.png", "--device", "cuda:99"], "no device 'cuda:99'"),
        (["{sheet}", "-o", "{folder}/x.png", "--camera", "1,2"], "seven numbers"),
        (["{sheet}", "-o", "{folder}/x.png", "--frames", "1..2"], "one picture"),
        (["{sheet}", "-o", "{folder}/x.png", "--frames", "3..1"], "A at most B"),
        (["{sheet}", "-o", "{folder}/new/x.gif"], "without Blender as .gif"),
        (["{sheet}", "-o", "{folder}/new/x.png", "--multilayer"], "writes OpenEXR files, and .*x.png is none"),
        (["{sheet}", "--film", "{folder}/x.npz", "--multilayer"], "give -o FILE.exr too"),
        (["{sheet}", "-o", "{sheet}/x.png"], "x.png cannot be written: Not a directory"),
        (["{sheet}", "--film", "{sheet}/x.npz"], "x.npz cannot be written"),
        (["{sheet}", "--json", "{sheet}/x.json"], "x.json cannot be written"),
        (["{sheet}", "--save-scene", "{sheet}/x.scene.npz"], "x.scene.npz cannot be written"),
        (["{folder}", "-o", "{folder}/x.png"], "what kind of file"),
        (["{folder}/none.npz", "-o", "{folder}/new/x.png"], "no file .*none.npz"),
        (
            ["{folder}/none.npz", "-o", "x.png", "--set", "geometry_budget=lots"],
            "geometry_budget = 'lots' is not valid: .*bytes",
        ),
        (["{folder}/bad.npz", "-o", "{folder}/new/x.png"], "bad.npz: array f names vertices"),
        (["{folder}/bad.scene.npz", "-o", "{folder}/new/x.png"], "bad.scene.npz is not a saved scene"),
        (["{sheet}", "--prewarm"], "takes no FILE"),
        (["{sheet}", "-o", "{folder}/x.png", "--passes", "Depth,Steps"], "no pass 'Steps'.*Node Steps"),
        (["{sheet}", "--heat-map", "Node Steps"], "not PASS=FILE.png"),
        (["{sheet}", "--heat-map", "Normal={folder}/x.png"], "Normal has three values"),
        (["{sheet}", "--heat-map", "Rays={sheet}/x.png"], "x.png cannot be written"),
    ],
)
def test_errors_are_one_line_and_leave_nothing_behind(sheet, tmp_path, capfd, arguments, message):
    np.savez(tmp_path / "bad.npz", v=np.zeros((3, 3), np.float32), f=np.array([[0, 1, 3]]))
    np.savez(tmp_path / "bad.scene.npz", v=np.zeros((3, 3), np.float32))
    before = listing(tmp_path)
    assert render.main([argument.format(sheet=sheet, folder=tmp_path) for argument in arguments]) == 1
    said = capfd.readouterr()
    assert said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("render.py: error: ")
    assert re.search(message, line), line
    assert listing(tmp_path) == before


def test_what_others_print_stays_off_standard_output(sheet, tmp_path, capfd, monkeypatch):
    from raybatch_addon.core.session import Session

    original = Session.render

    def noisy(self, *arguments, **options):
        print("from Python")
        os.write(1, b"from native code\n")
        return original(self, *arguments, **options)

    monkeypatch.setattr(Session, "render", noisy)
    assert render.main([str(sheet), "-o", str(tmp_path / "x.png"), "--json", "-", *SMALL]) == 0
    said = capfd.readouterr()
    assert json.loads(said.out)["engine"] == "RayBatch"
    # what people look for first
    assert list(json.loads(said.out))[:4] == ["engine", "warnings", "missing", "auto"]
    assert '"region": [0, 0, 16, 12]' in said.out
    assert "from" not in said.err
    assert render.main([str(sheet), "-o", str(tmp_path / "x.png"), "--verbose", *SMALL]) == 0
    said = capfd.readouterr()
    assert said.out == "" and "from native code" in said.err


@pytest.mark.parametrize(
    "value",
    [
        {},
        [],
        {"a": [], "b": {}},
        [1, 2.5, None, True],
        {"a": [[1, 2], [3, 4]], "b": [{"c": [0.25]}]},
        {"a": list(range(100))},
        ["[\n 1\n]", "one\ntwo", '"', "ä [1, 2]"],
        {"[\n": [1, -2e-9, float("inf")]},
        {1: [2]},
        "text",
        7,
    ],
)
def test_json_for_people_is_json(value):
    text = json_text(value)
    assert json.loads(text) == json.loads(json.dumps(value))
    assert all(len(line) < 130 for line in text.splitlines())


def test_short_lists_of_numbers_stand_on_one_line():
    assert json_text({"a": [1, 2], "b": [[0.5, 3], [1.5, 4]], "c": ["x"]}) == (
        '{\n  "a": [1, 2],\n  "b": [\n    [0.5, 3],\n    [1.5, 4]\n  ],\n  "c": [\n    "x"\n  ]\n}'
    )


def test_a_failed_render_keeps_the_old_picture(sheet, tmp_path, monkeypatch, capfd):
    from raybatch_addon.core.errors import OutOfMemoryError
    from raybatch_addon.core.session import Session

    out = tmp_path / "x.png"
    out.write_bytes(b"old")

    def fail(*_, **__):
        raise OutOfMemoryError("no memory\nfor this")

    monkeypatch.setattr(Session, "render", fail)
    assert render.main([str(sheet), "-o", str(out), *SMALL]) == 1
    assert out.read_bytes() == b"old"
    assert capfd.readouterr().err == "render.py: error: no memory for this\n"


@pytest.mark.thorough  # compiles the general kernels
def test_prewarm_fills_the_cache_folder():
    done = run_script("render.py", "--prewarm", "--device", "cpu", before=HIDE_BPY)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    folder = Path(done.stderr.strip().splitlines()[-1].partition("ready in ")[2])
    assert any(path.name.startswith("wp_") for path in folder.rglob("*"))


def test_prewarm_fails_where_kernels_cannot_be_kept(tmp_path):
    (tmp_path / "file").touch()
    done = run_script("render.py", "--prewarm", "--device", "cpu", RAYBATCH_KERNEL_CACHE=tmp_path / "file" / "kernels")
    assert "compiled kernels cannot be kept in" in error_line(done) and done.returncode == 1


def test_a_preset_comes_before_single_settings(sheet, tmp_path):
    saved = tmp_path / "s.scene.npz"
    sets = ("--set", "queue_size=9", "--set", "geometry_budget=1.5G", "--set", "sample_count=3")
    assert render.main([str(sheet), "--save-scene", str(saved), *sets, "--preset", "thesis"]) == 0
    settings = load_scene(saved)[1]
    assert settings == RenderSettings(**preset_settings("THESIS")).replace(
        queue_size=9, geometry_budget=1_500_000_000, sample_count=3
    )
    again = tmp_path / "again.scene.npz"
    assert render.main([str(saved), "--save-scene", str(again), "--preset", "AUTO"]) == 0
    assert load_scene(again)[1] == RenderSettings(sample_count=3), (
        "a preset takes the place of the whole schedule that the file had"
    )


@pytest.mark.parametrize(
    ("arguments", "weight"),
    [
        (["--strict", "a.blend"], "replaced"),
        (["a.blend"], None),
        (["--strict", "--json", "-", "a.blend"], "replaced"),
        (["--strict", "missing", "a.blend"], "missing"),
        (["a.blend", "--strict=setting"], "setting"),
    ],
)
def test_strict_does_not_take_the_file_for_its_weight(arguments, weight):
    options = render.argument_parser().parse_args(render.with_weight(arguments))
    assert (options.strict, str(options.file)) == (weight, "a.blend") and render.with_weight([]) == []


def test_the_help_lists_every_setting_and_preset():
    text = render.argument_parser().format_help()
    for name in (*SETTINGS, *PRESETS):
        assert f"\n  {name}" in text
    assert "Mi, Gi, Ti, of 1024" in text


def test_numbered_names():
    cwd = Path.cwd()
    assert numbered("a/x.npz", 7, many=False) == cwd / "a/x.npz"
    assert numbered("a/x.npz", 7, many=True) == cwd / "a/x0007.npz"
    assert numbered("/a/x_##_y.npz", 7, many=False) == Path("/a/x_07_y.npz")
    assert numbered("/a/x_###.npz", 12345, many=True) == Path("/a/x_12345.npz")
    assert numbered("/a/x_##.npz", -3, many=True) == Path("/a/x_-03.npz")


def test_passes_that_are_asked_for(sheet, tmp_path, capfd):
    film, steps = tmp_path / "film.npz", tmp_path / "maps/steps.png"
    assert (
        render.main(
            [
                str(sheet),
                "--passes",
                "Depth,rays",
                "--heat-map",
                f"Node Steps={steps}",
                "--film",
                str(film),
                CAMERA,
                *SMALL,
            ]
        )
        == 0
    )
    with np.load(film) as passes:
        assert passes.files == ["Combined", "Depth", "Rays", "Node Steps"]
        values = passes["Node Steps"][..., 0]
        assert (passes["Rays"] >= 1).all()
    assert f"saved {steps} (Node Steps, 0 to {values.max():.4g})" in capfd.readouterr().err
    pixels, largest = heat_pixels(values)
    assert largest == values.max() > 0 and (np.array(Image.open(steps)) == pixels).all()
    # nothing is known of Warp's tree, and that is said
    assert (
        render.main(
            [str(sheet), "--passes", "node steps", "--film", str(film), "--set", "batching=REFERENCE", CAMERA, *SMALL]
        )
        == 0
    )
    assert "does not tell its steps" in capfd.readouterr().err


def test_heat_colors():
    pixels, largest = heat_pixels(np.array([[0, 5], [10, np.inf]], np.float32))
    assert largest == 10
    assert (pixels[1, 0] == HEAT_COLORS[0]).all() and (
        pixels[0] == HEAT_COLORS[-1]
    ).all()  # the first row of values is the bottom
    assert 0 < pixels[1, 1].sum() < HEAT_COLORS[-1].sum()
    assert heat_pixels(np.array([[3.0, DEPTH_OF_NOTHING]], np.float32))[1] == 3
    pixels, _ = heat_pixels(np.zeros((2, 2), np.float32))
    assert (pixels == HEAT_COLORS[0]).all()
    brightness = HEAT_COLORS @ np.array([0.2126, 0.7152, 0.0722])
    assert (np.diff(brightness) > 0).all()


def test_display_colors():
    linear = np.array([[[0, 0.5, 1, 1]], [[0.25, 0.5, 9, 0.5]], [[0, 0, 0, 0]]], np.float32)
    pixels = display_pixels(linear)
    assert pixels[2, 0].tolist() == [0, 188, 255, 255]  # the first row of linear is the bottom
    assert pixels[1, 0].tolist() == [188, 255, 255, 128]
    assert pixels[0, 0].tolist() == [0, 0, 0, 0]


def test_another_resolution_keeps_what_the_longer_side_shows(sheet, tmp_path):
    scene = load_geometry(sheet, width=200, height=100)
    save_scene(tmp_path / "s.scene.npz", scene, RenderSettings())
    same = resized(scene, 400, 200)
    assert same.camera.window == pytest.approx(scene.camera.window)
    assert (same.frame.width, same.frame.height) == (400, 200)
    left, right, bottom, top = resized(scene, 100, 100).camera.window
    assert (left, right) == pytest.approx(scene.camera.window[:2])
    assert top - bottom == pytest.approx(right - left)
    tall = resized(scene, 100, 200).camera.window
    assert tall[3] - tall[2] == pytest.approx(right - left)
