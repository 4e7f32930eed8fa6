"""Features that the stages at a surface are specialised on."""

from __future__ import annotations

from dataclasses import dataclass

from ....scene.description import ClosureKind, LightKind
from ....scene.program import ProgramFeatures


@dataclass(frozen=True, kw_only=True)
class SurfaceFeatures:
    """The part of `SceneFeatures` that shading a surface depends on; fields have the same names."""

    closures: tuple[ClosureKind, ...]
    closure_count: int
    programs: ProgramFeatures
    lights: tuple[LightKind, ...]
    light_sphere: bool
    light_choice: bool
    mesh_lights: bool
    mesh_programs: bool
    world_light: bool
    light_programs: bool
    lamp_programs: bool
    path_history: bool
    mis: bool
    shadow_rays: bool
    instancing: bool
    smooth_normals: bool
    curves: bool
    terminator: bool
    sample_sequence: str
    passes: tuple[str, ...]
    clamping: bool
    roulette: bool
    bounces_by_kind: bool = False
    filter_glossy: bool = False
    caustics_reflective: bool = True
    caustics_refractive: bool = True
    light_links: bool = False
    shadow_links: bool = False
    light_groups: bool = False
    light_portals: bool = False  # the world is sampled through portals
    volume_lights: bool = False  # volumes that emit are emitters
    light_bounces: bool = False  # some emitters are aimed at from the first vertices of paths alone
    panorama_vectors: bool = False  # the pass Vector is that of a panorama
    moving: bool = False  # instances or vertices move
    film_glass: bool = False  # a transparent film shows through glass
    film_holes: bool = False  # surfaces cut holes into a film that has alpha
    records_surfaces: bool = False  # passes show what the first surfaces are
    splits_light: bool = False  # light is divided among passes
    catchers: bool = False  # some surfaces catch shadows
    guides: bool = False  # the film has passes that guide a denoiser

    @property
    def transparency(self) -> bool:
        """Surfaces that rays pass straight through."""
        return ClosureKind.TRANSPARENT in self.closures

    @property
    def portals(self) -> bool:
        """Surfaces that send rays on elsewhere."""
        return ClosureKind.RAY_PORTAL in self.closures

    @property
    def lacks_caustics(self) -> bool:
        """Light that glossy surfaces throw on diffuse ones is left out, or a part of it."""
        return not (self.caustics_reflective and self.caustics_refractive)

    @property
    def half_glass(self) -> bool:
        """Glass may reflect alone or refract alone, since one kind of caustics is left out."""
        return self.lacks_caustics and ClosureKind.GLASS in self.closures

    @property
    def changes_closures(self) -> bool:
        """Closures may be others to some paths."""
        return self.filter_glossy or self.half_glass

    @property
    def least_density(self) -> bool:
        """It matters how widely a path has scattered."""
        return self.filter_glossy or "bevel" in self.programs.ops

    @property
    def subsurface(self) -> bool:
        """Light that scatters below surfaces."""
        return ClosureKind.SUBSURFACE in self.closures

    @property
    def texture_levels(self) -> bool:
        """Images that are filtered over the footprints of paths."""
        return "image_level" in self.programs.ops

    @property
    def lobes_most(self) -> int:
        """Closures of a material at most; a power of two, so that scenes with nearly as many share kernels."""
        return 1 << (max(self.closure_count, self.programs.closure_count, 1) - 1).bit_length()

    @property
    def emission(self) -> bool:
        """Surfaces that emit."""
        return ClosureKind.EMISSION in self.closures
