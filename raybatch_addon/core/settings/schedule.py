"""Settings of the order in which rays are traced: they change time, never the picture."""

from __future__ import annotations

from dataclasses import dataclass

from .info import BYTES, INT_MAX, setting


@dataclass(frozen=True, kw_only=True)
class TracingSettings:
    """How rays are traced."""

    batching: str = setting(
        "AUTO",
        "Batching",
        "Let rays wait at parts of the tree (treelets) and visit them together, or let each ray go its way",
        group="BATCHING",
        effect="schedule",
        auto="AUTO",
        choices=(
            (
                "AUTO",
                "Auto",
                "On for a scene that does not fit in the device's memory; else what is expected to be fastest",
            ),
            ("ON", "On", "Rays wait in queues at treelets"),
            ("OFF", "Off", "Each ray visits the whole tree at once: fastest where the scene fits in memory"),
            ("REFERENCE", "Reference", "As off, with Warp's own tree: what the others are measured against"),
        ),
    )
    schedule: str = setting(
        "WAVEFRONT",
        "Schedule",
        "Who decides what is done next",
        group="BATCHING",
        effect="schedule",
        choices=(
            ("WAVEFRONT", "Wavefront", "The host: each stage is done for all rays that are ready for it, in turn"),
            (
                "STREAMING",
                "Streaming",
                "The device: one kernel, in which each warp takes the next work from queues of all stages. It is "
                "compiled for each scene; what it cannot render takes Wavefront, and the report says why",
            ),
        ),
    )
    ray_sort: str = setting(
        "AUTO",
        "Sort Rays",
        "Sort rays by direction and origin before they are traced",
        group="BATCHING",
        effect="schedule",
        auto="AUTO",
        choices=(
            ("AUTO", "Auto", "Where that was measured to save time, by kind of ray"),
            (
                "ON",
                "On",
                "Always, but for rays that wait for geometry beyond memory: these are traced in the order of their "
                "paths",
            ),
            ("OFF", "Off", "Never"),
        ),
    )
    hit_sort: str = setting(
        "AUTO",
        "Sort Hits",
        "Sort hits by material before they are shaded, so that threads beside each other run the same code",
        group="BATCHING",
        effect="schedule",
        auto="AUTO",
        choices=(
            ("AUTO", "Auto", "On a GPU, where the scene has materials that run different code"),
            ("ON", "On", "Wherever the scene has such materials"),
            ("OFF", "Off", "Never. Hits on geometry beyond the memory of a GPU follow their triangles whatever is set"),
        ),
    )
    tile_size: int = setting(
        0,
        "Tile Size",
        "Edge of the square tiles in which the frame is rendered and shown; {rest} chooses by device",
        group="PERFORMANCE",
        effect="schedule",
        unit="pixels",
        minimum=0,
        maximum=65_536,
        auto=0,
        start=256,
    )
    tile_order: str = setting(
        "AUTO",
        "Tile Order",
        "Whether the whole frame is seen early and refined, or tile after tile is finished. Where samples come pixel "
        "first, or geometry does not fit in memory, each tile gets all of its samples at once",
        group="PERFORMANCE",
        effect="schedule",
        auto="AUTO",
        choices=(
            ("AUTO", "Auto", "Progressive where a window shows it"),
            ("PROGRESSIVE", "Progressive", "A sample of each tile, then some seconds of work on each in turn"),
            ("TILE_FIRST", "Tile First", "All samples of a tile, then the next tile"),
        ),
    )
    spatial_splits: str = setting(
        "AUTO",
        "Spatial Splits",
        "Split triangles among the boxes of the tree: a slower build for faster rays where large or long triangles "
        "overlap",
        group="PERFORMANCE",
        effect="schedule",
        auto="AUTO",
        choices=(
            (
                "AUTO",
                "Auto",
                "On the CPU in renders of so many samples that faster rays save more than the build takes, but for "
                "meshes that move from frame to frame: their trees follow them. On CUDA trees are built on the "
                "device, without splits",
            ),
            ("OFF", "Off", "Each triangle is in one box"),
            ("ON", "On", "Triangles may be in several boxes (Stich et al. 2009). On CUDA the CPU builds the tree then"),
        ),
    )
    counters: str = setting(
        "OFF",
        "Counters",
        "Count the steps of every ray, by kind and bounce, and time each stage; the render takes longer",
        group="BATCHING",
        effect="schedule",
        choices=(
            ("OFF", "Off", "Nothing is counted, and nothing is paid for it"),
            ("ON", "On", "For the statistics and the passes that show cost"),
        ),
    )


@dataclass(frozen=True, kw_only=True)
class SchedulerSettings:
    """Which rays are alive, and what is done next."""

    ray_count: int = setting(
        0,
        "Rays Alive",
        "Paths alive at once in all workers together; {rest} chooses by device and scene. The panel's memory estimate "
        "says what each takes",
        group="SCHEDULER",
        effect="schedule",
        unit="paths",
        minimum=0,
        maximum=2**28,
        auto=0,
        start=2**20,
    )
    ray_low_water: float = setting(
        0.75,
        "Min Alive",
        "New paths are generated when fewer than this share of Rays Alive is left",
        group="SCHEDULER",
        effect="schedule",
        unit="of rays alive",
        minimum=0.0,
        maximum=1.0,
    )
    ray_high_water: float = setting(
        1.0,
        "Max Alive",
        "Share of Rays Alive up to which new paths are generated",
        group="SCHEDULER",
        effect="schedule",
        unit="of rays alive",
        minimum=0.0,
        maximum=1.0,
    )
    sample_order: str = setting(
        "FRAME_FIRST",
        "Sample Order",
        "Which path is generated next",
        group="SCHEDULER",
        effect="schedule",
        choices=(
            ("FRAME_FIRST", "Frame First", "One sample of every pixel of the tile, then the next sample"),
            ("PIXEL_FIRST", "Pixel First", "All samples of a pixel, then the next pixel"),
        ),
    )
    bucket_selection: str = setting(
        "AUTO",
        "Next Bucket",
        "Which bucket is served next: a treelet has one, with the rays that wait to enter it and those that left it",
        group="SCHEDULER",
        effect="schedule",
        auto="AUTO",
        choices=(
            ("AUTO", "Auto", "All, which was the fastest wherever it was measured"),
            ("MOST_FULL", "Most Full", "The one in which most rays wait"),
            ("NEXT", "Next", "The one behind the last, in turn, that is not empty"),
            ("RANDOM", "Random", "Any that is not empty, from random numbers that repeat"),
            ("ALL", "All", "Every bucket in each step, in one sorted sweep"),
            ("LAZY", "Lazy", "A number of buckets at a time, each until no ray waits there; then the fullest"),
            ("BALANCED", "Balanced", "In each step all buckets with more rays than the mean, so that none grows long"),
        ),
    )
    bucket_processors: int = setting(
        0,
        "Lazy Buckets",
        "Buckets that Lazy serves at a time; {rest} takes one for each multiprocessor of a GPU, and one on a CPU",
        group="SCHEDULER",
        effect="schedule",
        unit="buckets",
        minimum=0,
        maximum=2**16,
        auto=0,
        start=16,
    )
    bucket_wait_max: int = setting(
        0,
        "Longest Wait",
        "Steps of the scheduler after which a bucket is served before all fuller ones; {rest} lets rays wait as long "
        "as it takes",
        group="SCHEDULER",
        effect="schedule",
        unit="steps",
        minimum=0,
        maximum=INT_MAX,
        off=0,
        start=64,
    )
    queues_per_ray: int = setting(
        1,
        "Queues a Ray",
        "Treelets at which a ray waits at a time, at most: the next ones that it meets. With 1 it goes on behind one "
        "before it waits at another",
        group="SCHEDULER",
        effect="schedule",
        unit="treelets",
        minimum=1,
        maximum=8,
    )
    treelet_cache: int = setting(
        0,
        "Cached",
        "Memory of the treelets whose buckets were served last, through which rays go on without waiting, as if a "
        "cache held them; with {rest} they wait at each treelet",
        group="SCHEDULER",
        effect="schedule",
        unit=BYTES,
        minimum=0,
        maximum=INT_MAX,
        off=0,
        start=2**25,
    )
    treelet_prefetch: str = setting(
        "OFF",
        "Prefetch",
        "Ask for the treelets that most rays wait for, while rays visit others",
        group="SCHEDULER",
        effect="schedule",
        choices=(
            ("OFF", "Off", "Treelets come to caches when rays read them"),
            ("ON", "On", "Treelets that are likely next are brought to the caches before"),
        ),
    )
    top_level_traversal: str = setting(
        "NAIVE",
        "Top Level",
        "How the rays of a warp go through what is above the treelets. Not used on the CPU",
        group="SCHEDULER",
        effect="schedule",
        choices=(
            ("NAIVE", "Naive", "A lane takes the next ray as soon as its own is through"),
            ("INTERLOCKED", "Interlocked", "Lanes take new rays together, when all of their rays are through"),
            (
                "SHORT_SEGMENT",
                "Short Segment",
                "All rays of a warp visit the same nodes until one enters a treelet: there all of them wait, those "
                "that do not enter behind it",
            ),
            (
                "LONG_HAUL",
                "Long Haul",
                "All rays of a warp visit the same nodes, and those that come to a treelet make room for others",
            ),
        ),
    )
