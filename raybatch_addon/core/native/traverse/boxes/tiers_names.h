// The way down a trail has another name where large treelets are on it (`tiers.h`).
#define follow follow_to_treelet
