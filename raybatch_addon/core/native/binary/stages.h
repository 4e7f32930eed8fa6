// The stages of the CPU builder: one step for tasks or jobs first..end, on one thread.
Task* tasks = (Task*)task_bytes.data;
Job* jobs = (Job*)job_bytes.data;
Bins* all_bins = (Bins*)arrays.bins.data;
f8u* records[2] = {(f8u*)arrays.records_0.data, (f8u*)arrays.records_1.data};
f8u* nodes = (f8u*)arrays.nodes.data;
Options options = {numbers.leaf_group, numbers.leaf_max, numbers.traversal_cost, numbers.group_inverse};
const Spatial spatial = {arrays.positions.data, arrays.triangles.data};
SpatialBins* all_spatial_bins = (SpatialBins*)arrays.bins.data;

// Whether a spatial split promises anything: there must be room for more references, and more than copies of one
// triangle
auto is_spatial = [&](const Task& task) {
    return task.capacity > task.count && task.kind != HALF &&
           Spatial::is_worthwhile(task, numbers.split_overlap, numbers.root_area);
};

auto write_node = [&](f8u* node, f8 box, int a, int count) {
    f4 low = -Sah::low4(box), high = Sah::high4(box);
    low += 0.0f;  // never -0
    low[3] = Sah::from_bits(a);
    high[3] = Sah::from_bits(count);
    *node = Sah::join(low, high);
};

auto make_records = [&](Job& job) {
    Sah::Bounds bounds;
    for (long long i = job.first; i < job.first + job.count; i++) {
        f4 low = {}, high = {};
        for (int c = 0; c < 3; c++) {
            const float* corner = arrays.positions.data + 3ll * arrays.triangles.data[3 * i + c];
            f4 p = {corner[0], corner[1], corner[2], 0};
            p += 0.0f;  // never -0, so that no order of comparisons shows
            low = c == 0 || p < low ? p : low;
            high = c == 0 || p > high ? p : high;
        }
        low = 0.0f - low;
        low[3] = Sah::index_lane(i);
        f8 record = Sah::join(low, high);
        records[0][i] = record;
        bounds.add(record);
    }
    job.bounds[0] = bounds.box;
    job.bounds[1] = bounds.middles;
};

auto move = [&](const Task& task, long long first, long long count, long long left, long long right,
                Sah::Bounds* bounds) {
    const f8u* from = records[task.buffer];
    f8u* to = records[1 - task.buffer];
    if (task.kind == SPATIAL) spatial.partition(from, to, task, first, count, left, right, bounds);
    else Sah::partition(from, to, task, first, count, left, right, bounds);
};

auto partition = [&](Job& job) {
    Sah::Bounds bounds[2];
    move(tasks[job.task], job.first, job.count, job.left, job.right, bounds);
    for (int side = 0; side < 2; side++) {
        job.bounds[2 * side] = bounds[side].box;
        job.bounds[2 * side + 1] = bounds[side].middles;
    }
};

// Chooses a split of a node in two, or makes it a leaf
auto decide = [&](Task& task) {
    const f8u* own = records[task.buffer];
    bool may_be_leaf = task.count <= options.leaf_max;
    // a split costs a step at least
    if (may_be_leaf &&
        (task.count == 1 || Sah::groups(options, task.count) <= options.traversal_cost || Sah::must_halve(task))) {
        task.kind = LEAF;
        return;
    }
    Sah::Measure measure(task.box);
    Sah::halve(task, options, measure);
    if (Sah::must_halve(task)) return;
    if (!Sah::is_spread(task.middle)) {
        // many copies of one triangle: nothing to choose by
    } else if (task.count <= EXACT_MAX) {
        Sah::choose_exact(own, options, measure, task);
    } else {
        Bins bins;
        Sah::bin(own, task, task.first, task.count, bins);
        Sah::choose_object(bins, options, measure, task);
    }
    if (is_spatial(task)) {
        Task trial = task;
        SpatialBins bins;
        spatial.bin(own, task, task.first, task.count, bins);
        if (Spatial::choose(bins, options, measure, trial)) {
            spatial.count(own, trial, trial.first, trial.count, trial.left_count, trial.right_count);
            if (trial.left_count && trial.right_count && trial.left_count + trial.right_count <= trial.capacity)
                task = trial;
        }
    }
    float area = measure(task.box);
    if (may_be_leaf && !(options.traversal_cost * area + task.cost < area * Sah::groups(options, task.count)))
        task.kind = LEAF;
};

auto subtree = [&](Task& root) {
    f8u* own = nodes + 2 * root.first;
    int* list = arrays.references.data + root.first;
    long long node_count = 1, listed = 0;
    root.leaf_count = root.leaf_largest = root.depth_max = 0;
    Task stack[DEPTH_MAX + 2];
    int top = 0;
    stack[top] = root;
    stack[top++].node = 0;
    while (top) {
        Task task = stack[--top];
        decide(task);
        if (task.kind == LEAF) {
            write_node(own + task.node, task.box, listed, task.count);
            for (long long i = 0; i < task.count; i++)
                list[listed++] = Sah::index(records[task.buffer][task.first + i]);
            root.leaf_count++;
            if (task.count > root.leaf_largest) root.leaf_largest = task.count;
            if (task.depth > root.depth_max) root.depth_max = task.depth;
            continue;
        }
        Task& right = stack[top++];
        Task& left = stack[top++];
        Sah::children(task, left, right);
        Sah::Bounds bounds[2];
        move(task, task.first, task.count, left.first, right.first, bounds);
        left.box = bounds[0].box;
        left.middle = bounds[0].middles;
        right.box = bounds[1].box;
        right.middle = bounds[1].middles;
        write_node(own + task.node, task.box, node_count, 0);
        left.node = node_count++;
        right.node = node_count++;
    }
    root.node_count = node_count;
    root.reference_count = listed;
};

// Copies a subtree into the result: its root takes the number that its parent gave it
auto gather = [&](const Task& task) {
    const f8u* own = nodes + 2 * task.first;
    f8u* tree = (f8u*)arrays.tree_nodes.data;
    for (long long i = 0; i < task.node_count; i++) {
        f8 node = own[i];
        int a = Sah::bits(node[3]);
        bool leaf = Sah::bits(node[7]) > 0;
        node[3] = Sah::from_bits((int)(a + (leaf ? task.reference_first : task.node_first - 1)));
        tree[i == 0 ? task.node : task.node_first + i - 1] = node;
    }
    const int* list = arrays.references.data + task.first;
    for (long long i = 0; i < task.reference_count; i++)
        arrays.tree_references.data[task.reference_first + i] = list[i];
};

// Chooses the split of a large node, and counts the records of each job that go to either side
auto choose = [&](Task& task) {
    Sah::Measure measure(task.box);
    Sah::halve(task, options, measure);
    if (!Sah::must_halve(task)) {
        Bins bins = all_bins[task.job_first];
        for (int j = task.job_first + 1; j < task.job_end; j++) Sah::merge(bins, all_bins[j]);
        Sah::choose_object(bins, options, measure, task);
        task.spatial = is_spatial(task);
    }
    for (int j = task.job_first; j < task.job_end; j++) {
        Job& job = jobs[j];
        job.left_count = 0;
        if (task.kind == OBJECT)
            for (int b = 0; b <= task.bin; b++) job.left_count += all_bins[j].count[task.axis][b];
        else if (task.left_count > job.first - task.first)
            job.left_count = task.left_count - (job.first - task.first) < job.count
                                 ? task.left_count - (job.first - task.first)
                                 : job.count;
        job.right_count = job.count - job.left_count;
    }
};

auto choose_spatial = [&](Task& task) {
    SpatialBins bins = all_spatial_bins[task.job_first];
    for (int j = task.job_first + 1; j < task.job_end; j++) Spatial::merge(bins, all_spatial_bins[j]);
    Spatial::choose(bins, options, Sah::Measure(task.box), task);
};

for (long long i = first; i < end; i++) switch (stage) {
    case RECORDS:
        make_records(jobs[i]);
        break;
    case BIN: {
        const Task& task = tasks[jobs[i].task];
        Sah::bin(records[task.buffer], task, jobs[i].first, jobs[i].count, all_bins[i]);
        break;
    }
    case CHOOSE:
        choose(tasks[i]);
        break;
    case SPATIAL_BIN: {
        const Task& task = tasks[jobs[i].task];
        spatial.bin(records[task.buffer], task, jobs[i].first, jobs[i].count, all_spatial_bins[i]);
        break;
    }
    case SPATIAL_CHOOSE:
        choose_spatial(tasks[i]);
        break;
    case SPATIAL_COUNT: {
        const Task& task = tasks[jobs[i].task];
        if (task.kind == SPATIAL)
            spatial.count(
                records[task.buffer], task, jobs[i].first, jobs[i].count, jobs[i].left_count, jobs[i].right_count
            );
        break;
    }
    case PARTITION:
        partition(jobs[i]);
        break;
    case SUBTREE:
        subtree(tasks[i]);
        break;
    case GATHER:
        gather(tasks[i]);
        break;
    }
