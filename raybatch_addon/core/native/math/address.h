// The address of the element FIRST of `values`.
return reinterpret_cast<wp::uint64>(values.data + FIRST);
