// Path costs along one of four directions: 0 right, 1 left, 2 down, 3 up. A pixel of path cost c adds to its neighbour
// on the path m = min(c, min c + e jump) - min c, which is left in 16 bits for `path_winner.wgsl`. The
// dispatches write to arrays of their own, so that a device may run both rows, and both columns, side by side. What is a
// pixel's own is in `own_of_rows.wgsl` and `own_of_columns.wgsl`. A step computes little and would wait for the memory:
// what it needs is read `ahead` steps before.

@group(0) @binding(0) var<storage, read> likelihood: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(1) var<storage, read> guide: array<f32>;  // planes; the guide is the one behind K others
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> costs: array<vec2u>;  // (h, w, pitch / 4)

const pixel_vectors = pitch / 4u;

fn pixel_of(s: u32, line: u32, steps: u32) -> u32 {
    let along = select(s, steps - 1u - min(s, steps - 1u), (direction & 1u) == 1u);
    let inside = min(along, steps - 1u);
    return select(inside * width + line, line * width + inside, direction < 2u);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let line_count = select(width, height, direction < 2u);
    let steps = select(height, width, direction < 2u);
    lane_here = local;
    let line = group.x * (64u / lanes) + local / lanes;
    let lane = local % lanes;
    let used = line < line_count;
    let here = min(line, line_count - 1u);
    var own: array<Own, ahead * vectors>;
    var own_guide: array<f32, ahead>;
    for (var j = 0u; j < ahead; j++) {  // unrolled
        let pixel = pixel_of(j, here, steps);
        own_guide[j] = guide[guide_plane + pixel];
        for (var v = 0u; v < vectors; v++) {  // unrolled
            own[j * vectors + v] = own_read(pixel * pixel_vectors + min(v * lanes + lane, pixel_vectors - 1u));
        }
    }
    var cost: array<vec4f, vectors>;
    var least = 0.0;
    var before_guide = 0.0;
    let edge = stats[GUIDE_SCALE] / edge_range;
    for (var s = 0u; s < steps; s += ahead) {
        for (var j = 0u; j < ahead; j++) {  // unrolled
            if (s + j >= steps) { break; }
            let pixel = pixel_of(s + j, here, steps);
            let next = pixel_of(s + j + ahead, here, steps);
            let link = edge_floor + (1.0 - edge_floor) * exp(-abs(own_guide[j] - before_guide) * edge);
            let limit = select(least + link * jump, 0.0, s + j == 0u);
            before_guide = own_guide[j];
            own_guide[j] = guide[guide_plane + next];
            var lowest = vec4f(1.0e30);
            for (var v = 0u; v < vectors; v++) {  // unrolled
                if ((v + 1u) * lanes <= pixel_vectors || v * lanes + lane < pixel_vectors) {
                    let at = v * lanes + lane;
                    let own_here = own[j * vectors + v];
                    own[j * vectors + v] = own_read(next * pixel_vectors + at);
                    let incoming = select(min(cost[v], vec4f(limit)) - least, vec4f(), s + j == 0u);
                    if (used) { costs[pixel * pixel_vectors + at] = packed(incoming); }
                    cost[v] = incoming + own_cost(own_here);
                    lowest = min(lowest, cost[v]);
                }
            }
            least = least_of_lanes(min(min(lowest.x, lowest.y), min(lowest.z, lowest.w)));
        }
    }
}
