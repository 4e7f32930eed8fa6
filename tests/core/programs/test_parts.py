"""Parts of programs: those that make transparent closures, which shadow rays run instead of whole programs."""

from raybatch_addon.core.programs import ops  # noqa: F401  (registers ops)
from raybatch_addon.core.programs.builder import ProgramBuilder
from raybatch_addon.core.programs.op import op_named
from raybatch_addon.core.programs.ops.values.math import MathOperation
from raybatch_addon.core.programs.parts import TRANSPARENT_OPS, transparent_parts
from raybatch_addon.core.scene.description import ClosureKind
from raybatch_addon.core.scene.program import Program
from tests.core.programs.host_program import closures_seen_at

BLUE = ClosureKind.TRANSPARENT


def surface(holes: float | None) -> Program:
    """A surface whose colour and normal take many steps, and whose holes take others; None: without holes."""
    builder = ProgramBuilder()
    normal = builder.value("normals")[0]
    share = builder.value("math", int(MathOperation.ADD), 0, builder.value("separate_xyz", normal)[2], -0.75, 0.0)
    color = builder.value(
        "combine_xyz", share, share, builder.value("math", int(MathOperation.SINE), 0, share, 0.0, 0.0)
    )
    if holes is not None:
        builder.closure("transparent", builder.value("multiply_colors", (holes,) * 3, builder.value("splat", share)))
    builder.closure("diffuse", color, normal)
    return builder.finish()


def test_the_part_makes_the_transparent_closures_of_the_whole_and_no_other():
    whole = surface(0.5)
    (part,) = transparent_parts([whole])
    made = closures_seen_at(whole, 0.5)
    assert [closure.kind for closure in made] == [ClosureKind.TRANSPARENT, ClosureKind.DIFFUSE]
    assert closures_seen_at(part, 0.5) == made[:1]
    assert "combine_xyz" not in {step.op for step in part.instructions}
    assert len(part.instructions) < len(whole.instructions) - 2


def test_what_is_opaque_has_no_part():
    assert transparent_parts([surface(None), surface(0.0), None]) == [None] * 3


def test_a_program_of_several_materials_has_one_part():
    shared = surface(0.5)
    first, other, last = transparent_parts([shared, surface(0.5), shared])
    assert first is last and first is not other


def test_no_other_op_makes_transparent_closures():
    """Ops name the kinds that they make in their code."""
    names = {"_TRANSPARENT", "TRANSPARENT"}
    from raybatch_addon.core.programs.op import op_names

    makers = {
        name
        for name in op_names()
        if op_named(name).makes_closures and names & set(op_named(name).function.func.__code__.co_names)
    }
    assert makers <= TRANSPARENT_OPS and "transparent" in TRANSPARENT_OPS
