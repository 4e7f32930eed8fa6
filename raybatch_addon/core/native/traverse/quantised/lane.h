// What a lane holds in a whole quantised tree.
//
// A ray; the node that it visits next; the group of nodes that come after (the first of them, and from bit 24 which;
// below, which of the child slots of their parent are inner) with more such groups on its stack; one or two groups of
// triangles to test (the first, and which). In the top level the triangles are entries, and such groups may be on the
// stack too. The triangle of the closest hit so far is in `hit_primitive`, its entry in `hit_instance`, until `finish`
// looks them up.

constexpr unsigned NONE = 0xffffffffu;
const Words* nodes = (const Words*)tree.nodes.data;
const Words* triangles = (const Words*)tree.triangles.data;
auto is_nodes = [](const Group& g) -> bool { return g.y > 0x00ffffffu; };

int slot = -1;  // ray slot, -1: none
Ray ray = {};
float best = 0.0f;  // distance of the closest hit so far, or t_max
unsigned node = NONE;
Group inner = {0u, 0u}, leaf = {0u, 0u};
Group later = {0u, 0u};  // triangles of an earlier node; none unless `leaf` has some
int depth = 0;           // groups on the stack
int entry = -1;          // the tree that the ray is in, -1: the top level
int bottom = 0;          // groups on the stack that belong to the top level
bool turned = false;     // the ray has come to another tree, for which `ray` is not made yet
unsigned first_node = 0u, first_triangle = 0u;
unsigned top_order = 0u;  // `ray.order` in the top level
Group stack[STACK_SIZE];
#if MOTION
BetweenSteps between = {0, 0, 0.0f};  // in triangles
#endif

// What the steps that whole and cut trees share ask of a lane
auto in_top_level = [&]() -> bool { return entry < 0; };
auto asks_any = [&]() -> bool { return ANY_HIT; };
auto to_top_blocks = [&]() {
    first_node = top_node_of(slot);
    first_triangle = 0u;
};
auto to_entry_blocks = [&]() {
    first_node = tree.entry_node.data[entry];
    first_triangle = tree.entry_triangle.data[entry];
};
auto end_any = [&]() {};
auto may_visit = [&](bool in_mesh) -> bool { return (in_mesh && LEAF_GROUPS == 2 ? later.y : leaf.y) == 0u; };
