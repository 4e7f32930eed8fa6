// What a lane holds in a quantised tree that is cut into treelets.
//
// As `lane.h`, except that indices are relative to the blocks of the tree or treelet that the ray is in, whose
// addresses are the lane's own. Groups of nodes have in bits 8 to 15 the level of the node that holds them, counted
// from the root of the top level or, if there is none, of the mesh; in bit 16 whether they are of a treelet, and then
// the level is that of its root.

constexpr unsigned NONE = 0xffffffffu;
// in `state`
constexpr unsigned LEVEL = 0x0000ff00u;  // level of the node visited last, or next, above treelets and of their roots
constexpr unsigned ONE_LEVEL = 0x00000100u;
constexpr unsigned IN_TREELET = 1u << 16;  // the ray is below the root of `treelet`
constexpr unsigned AT_ROOT = 1u << 17;     // `node` is the root of `treelet`; it is visited when no triangle waits
constexpr unsigned DESCENDING = 1u << 18;  // down the trail towards `treelet`, which is done
// the ray has come from a queue into `treelet`: its way there is in `progress` alone
constexpr unsigned CAME = 1u << 19;
constexpr unsigned NODES_ONLY = 1u << 20;  // no triangles of `treelet` are there
constexpr unsigned STOPPED = 1u << 21;     // no more nodes are visited
constexpr unsigned IN_MESH = 1u << 22;     // with a top level: the ray is below it
constexpr unsigned TURNED = 1u << 23;      // the ray has come to another tree, for which `ray` is not made yet
const Words* const resident_nodes = (const Words*)tree.nodes.data;
const Words* const resident_triangles = (const Words*)tree.triangles.data;
auto is_nodes = [](const Group& g) -> bool { return g.y > 0x00ffffffu; };

int slot = -1;  // ray slot, -1: none
Ray ray = {};
float best = 0.0f;  // distance of the closest hit so far, or t_max
const Words* nodes = resident_nodes;
const Words* triangles = resident_triangles;
unsigned node = NONE;
Group inner = {0u, 0u}, leaf = {0u, 0u};
Group later = {0u, 0u};  // triangles of an earlier node; none unless `leaf` has some
int depth = 0;           // groups on the stack
unsigned state = 0u;
Group stack[STACK_SIZE + 4];
// What is seldom used lies behind the stack, in memory: registers are few
unsigned& list_index = stack[STACK_SIZE].x;    // of the ray
unsigned& entry_level = stack[STACK_SIZE].y;   // `state` at the node that lists `entry`, in its LEVEL
int& treelet = (int&)stack[STACK_SIZE + 1].x;  // that the ray is in, stops at, or comes from; -1: none
unsigned& visit_count = stack[STACK_SIZE + 1].y;
int no_entry = -1, no_bottom = 0;  // constants if there is no top level
// the tree that the ray is in, -1: the top level
int& entry = TWO_LEVEL ? (int&)stack[STACK_SIZE + 2].x : no_entry;
// groups on the stack that belong to the top level
int& bottom = TWO_LEVEL ? (int&)stack[STACK_SIZE + 2].y : no_bottom;
unsigned& top_order = stack[STACK_SIZE + 3].x;  // `ray.order` in the top level
treelet = entry = -1;
bottom = 0;
visit_count = 0u;
unsigned char trail[TRAIL_SIZE];  // the bit that was taken, by level
#if MOTION
BetweenSteps between = {0, 0, 0.0f};  // in triangles
#endif

// What the steps that whole and cut trees share ask of a lane
auto in_top_level = [&]() -> bool { return !(state & IN_MESH); };
auto asks_any = [&]() -> bool { return slot >= listed.any_first; };
auto to_top_blocks = [&]() { nodes = resident_nodes + NODE * (unsigned)top_node_of(slot); };
auto to_entry_blocks = [&]() {
    nodes = resident_nodes + NODE * (unsigned)tree.entry_node.data[entry];
    triangles = resident_triangles + TRIANGLE * (unsigned)tree.entry_triangle.data[entry];
};
auto to_treelet_blocks = [&]() {
    nodes = (const Words*)treelets.nodes.data[treelet];
    triangles = (const Words*)treelets.triangles.data[treelet];
#if MOTION
    between = between_steps(treelets.deform.data[treelet], time_of(slot));
#endif
};
auto end_any = [&]() {
    treelet = -1;
    state = STOPPED;
};
// a treelet's root waits until no triangle does: its own are in other blocks
auto may_visit = [&](bool in_mesh) -> bool { return (in_mesh && !(state & AT_ROOT) ? later.y : leaf.y) == 0u; };
