// A look at a node has another name where it may be the root of a large treelet (`tiers.h`).
#define look_at look_at_treelet
