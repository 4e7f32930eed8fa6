// The loop over the rays that one thread traces through a whole tree of the layout BOXES, one after another.

Ray ray;
clear_stack(ray);
for (int i = first; i < end; ++i) {
    for (int child = begin(ray, listed.slots.data[i]) ? 0 : END; child != END;) {
        ray.child = child;
        ray.at = address(ray, child);
        if (child >= 0) {
            Floats enter;
            const unsigned met = meet(ray, ray.at, enter);
            const int* children = children_at(ray.at);
            if (met != 0u) {
                for (unsigned rest = met; rest; rest &= rest - 1u) ask_for(address(ray, children[__builtin_ctz(rest)]));
                if ((met & (met - 1u)) == 0u) {
                    child = children[__builtin_ctz(met)];
                } else {
                    ray.top += put_off(ray, ray.at, enter, met) - 1;
                    child = ray.waiting[ray.top];
                }
                continue;
            }
        } else if (child == LEAVE) {
            to_top(ray);
        } else if (!TWO_LEVEL || ray.entry >= 0) {
            test_leaf(ray);
        } else if (enter_tree(ray)) {
            child = 0;
            continue;
        }
        do --ray.top;
        while (ray.distance[ray.top] > ray.best);
        child = ray.waiting[ray.top];
    }
    finish(ray);
}
