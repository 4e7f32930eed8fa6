// The key of the ray in `slot`.
return ray_key(slot);
