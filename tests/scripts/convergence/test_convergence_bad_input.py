"""scripts/convergence.py: what it says when it cannot, and that it leaves nothing behind."""

import re

import convergence
import numpy as np
import pytest

from raybatch_addon.core.convergence.points import Reference, save_reference, scene_hash
from raybatch_addon.core.errors import RayBatchError
from raybatch_addon.core.session import Session
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support.command_line import HIDE_BPY, error_line, run_script
from tests.support.convergence_runs import SMALL, measured, picture_alone
from tests.support.under_test import DEVICE


@pytest.fixture(autouse=True)
def own_folder(tmp_path_factory, monkeypatch):
    """References are kept apart from the user's."""
    monkeypatch.setenv("RAYBATCH_REFERENCES", str(tmp_path_factory.mktemp("references")))


def one_error(capfd, arguments) -> str:
    """The line that an unsuccessful run says."""
    assert convergence.main([*map(str, arguments)]) == 1
    said = capfd.readouterr()
    assert said.out == ""
    (line,) = [line for line in said.err.splitlines() if line.startswith("convergence.py: error: ")]
    return line


@pytest.fixture
def folder(tmp_path, lit):
    """References that cannot be used, and what is no reference."""
    hashed, settings = scene_hash(picture_alone(lit)), RenderSettings(bounce_max=1)
    picture = np.full((16, 20, 3), 0.5)
    good = Reference(picture, np.full_like(picture, 1e-4), "made by hand", 100)
    save_reference(tmp_path / "good.npz", good, hashed, settings)
    save_reference(tmp_path / "large.npz", Reference(np.ones((16, 21, 3))), hashed, settings)
    save_reference(tmp_path / "scene.npz", good, "0" * 32, settings)
    save_reference(tmp_path / "bounces.npz", good, hashed, settings.replace(bounce_max=3))
    np.savez(tmp_path / "nan.npz", Combined=np.full((16, 20, 4), np.nan, np.float32))
    np.savez(
        tmp_path / "inf.npz", Combined=np.where(np.eye(16, 20)[..., None] > 0, np.inf, np.ones((16, 20, 4), np.float32))
    )
    np.savez(tmp_path / "other.npz", v=np.zeros((3, 3)))
    (tmp_path / "damaged.npz").write_bytes((tmp_path / "good.npz").read_bytes()[:300])
    (tmp_path / "text.npz").write_text("not an archive")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seconds", "0"], "--seconds 0 is not valid: it must be above 0"),
        (["--seconds", "-1"], "--seconds -1 is not valid"),
        (["--seconds", "nan"], "--seconds nan is not valid"),
        (["--target", "0"], "--target 0 is not valid"),
        (["--target", "inf"], "--target inf is not valid"),
        (["--runs", "0"], "--runs 0 is not valid: it must be 1 or more"),
        (["--samples", "0"], "--samples 0 is not valid"),
        (["--reference-samples", "1"], "it must be 2 or more"),
        (["--size", "20"], "resolution = '20' is not valid"),
        (["--grid", "0"], "whole scene"),
        (["--compare", "neee=ON,OFF"], "no setting is called 'neee'; did you mean nee"),
        (["--compare", "neee"], "no setting is called 'neee'; did you mean nee"),
        (["--compare", "nee"], "names no values; write --compare nee=A,B,C"),
        (["--compare", "nee=,"], "names no values"),
        (["--compare", "nee=ON,MAYBE"], "nee.*one of ON, OFF, HALF"),
        (["--compare", "preset=AUTO,SLOW"], "no preset is called 'SLOW'"),
        (["--compare", "nee=ON", "--compare", "nee=OFF"], "--compare nee is given twice"),
        (["--compare", "nee=ON,OFF", "--set", "nee=ON"], "nee is compared, and set for all too"),
        (["--compare", "sample_count=1,2"], "--compare sample_count is not possible: --samples says it"),
        (["--compare", "treelet_size_min=4,900000", "--set", "treelet_size=9"], "treelet_size_min"),
        (["--set", "error_target=1"], "--set error_target is not possible: --target says it"),
        (["--set", "time_limit=1"], "--set time_limit is not possible: --seconds says it"),
        (["--against", "cycles"], "--against cycles needs a .blend, not lit.scene.npz"),
        (["--reference", "cycles"], "--reference cycles needs a .blend"),
        (["--reference", "halves", "--reference-samples", "8"], "--reference-samples is for a reference that is made"),
        (["--reference", "halves", "--samples", "1"], "needs two samples or more"),
        (
            ["--reference", "{folder}/good.npz", "--save-reference", "{folder}/new.npz"],
            "--save-reference is for a reference that is made",
        ),
        (["--compare", "bounce_max=1,2", "--save-reference", "{folder}/new.npz"], "--save-reference holds one picture"),
        (["--preset", "SLOW"], "no preset is called 'SLOW'"),
        (["--preset", "AUTO", "--compare", "preset=AUTO,UNBATCHED"], "preset is compared, and set for all too"),
        (["--save-reference", "{folder}/new.exr"], "name it with the ending .npz"),
        (["--reference", "{folder}/none.npz"], "there is no file .*none.npz"),
        (["--reference", "Raybatch"], "there is no file Raybatch; --reference is a file, or one of raybatch, cycles"),
        (["--samples", "8", "--set", "sample_count=4"], "--samples and --set sample_count say the same"),
        (["--reference", "{folder}/large.npz"], "large.npz is 21 x 16 pixels and the render 20 x 16"),
        (["--reference", "{folder}/scene.npz"], "scene.npz shows another scene"),
        (["--reference", "{folder}/bounces.npz"], "made with bounce_max = 3, and the render has 1"),
        (["--reference", "{folder}/nan.npz"], "not finite"),
        (["--reference", "{folder}/inf.npz"], "not finite"),
        (["--reference", "{folder}/damaged.npz"], "damaged.npz cannot be read as a reference"),
        (["--reference", "{folder}/text.npz"], "text.npz cannot be read as a reference"),
        (["--reference", "{folder}/other.npz"], "other.npz is no reference"),
        (
            ["--reference", "{folder}/good.npz", "--target", "1e-5"],
            "the reference's own noise is a relMSE of 0.000385.*least that it allows is 0.0004;",
        ),
        (["--plot", "{folder}/new/plot.gif"], "name it with one of the endings"),
        (["--json", "{folder}"], "cannot be written: it is a folder"),
        (["--device", "cuda:99", "--html", "{folder}/new/page.html"], "device"),
    ],
)
def test_what_cannot_be_is_one_line_and_nothing_is_rendered_or_written(
    arguments, message, folder, lit, capfd, monkeypatch
):
    monkeypatch.setattr(Session, "render", lambda *_, **__: pytest.fail("rendered"))
    before = {str(path) for path in folder.rglob("*")}
    asked = [
        lit,
        *([] if "--device" in arguments else ["--device", DEVICE]),
        *(text.format(folder=folder) for text in arguments),
    ]
    outputs = [] if "--json" in arguments else ["--json", folder / "new/report.json"]
    line = one_error(capfd, [*asked, *outputs])
    assert re.search(message, line), line
    assert {str(path) for path in folder.rglob("*")} == before


def test_a_scene_that_cannot_be_read_is_one_line(tmp_path, capfd):
    (tmp_path / "a.blend").write_bytes(b"no blend")
    for name in ("a.obj", "a.txt"):
        (tmp_path / name).write_text("")
        assert one_error(capfd, [tmp_path / name]).endswith(
            "what kind of file is this? It must end in .blend, .scene.npz, .npz"
        )
    assert "there is no file" in one_error(capfd, [tmp_path / "none.scene.npz"])
    done = run_script("convergence.py", tmp_path / "a.blend", before=HIDE_BPY)
    assert "needs Blender's Python module bpy" in error_line(done)


def test_a_target_below_the_noise_of_a_reference_that_was_made(lit, tmp_path, capfd):
    options = (
        lit,
        *SMALL,
        "--no-flip",
        "--samples",
        "4",
        "--reference-samples",
        "32",
        "--new-reference",
        "--html",
        tmp_path / "new/page.html",
    )
    line = one_error(capfd, [*options, "--target", "1e-9"])
    least = float(re.search(r"The least that it allows is ([\d.e-]+);", line)[1])
    assert "more --reference-samples" in line and not (tmp_path / "new").exists()
    assert measured(capfd, *options, "--target", least)["target"]["relmse"] == least


def test_a_run_that_fails_or_is_stopped_leaves_nothing(lit, tmp_path, capfd, monkeypatch):
    render, count = Session.render, []

    def failing(error):
        def call(self, *arguments, **options):
            count.append(1)
            if len(count) > 3:
                raise error
            return render(self, *arguments, **options)

        return call

    new = tmp_path / "new"
    outputs = [
        "--json",
        new / "r.json",
        "--plot",
        new / "p.svg",
        "--html",
        new / "p.html",
        "--save-reference",
        new / "r.npz",
    ]
    for error, code in ((RayBatchError("the device is gone"), 1), (KeyboardInterrupt(), 130)):
        count.clear()
        monkeypatch.setattr(Session, "render", failing(error))
        assert (
            convergence.main(
                [str(each) for each in (lit, *SMALL, "--no-flip", "--samples", "2", "--new-reference", *outputs)]
            )
            == code
        )
        said = capfd.readouterr()
        if "wp_compile_cpp" in said.err:
            pytest.skip("this machine cannot compile kernels for the CPU")
        assert said.out == "" and not new.exists(), said.err
    count.clear()
    monkeypatch.setattr(Session, "render", failing(MemoryError("no room")))
    with pytest.raises(MemoryError):
        convergence.main(
            [str(each) for each in (lit, *SMALL, "--no-flip", "--samples", "2", "--new-reference", *outputs)]
        )
    assert not new.exists()
