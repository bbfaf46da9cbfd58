// Adds what lines across borders say of the grid points beside these, which may lie on either plane; see
// `plane_edges.py`. A point that becomes near moves the edge beyond it.

@group(0) @binding(0) var<storage, read> line_at: array<u32>;  // (2, h, w): 1 + line behind a point to the right, below
@group(0) @binding(1) var<storage, read> lines: array<vec4u>;  // near and far plane, see `heard`, weight as bits
@group(0) @binding(2) var<storage, read> costs: array<f32>;  // (lines, 2 shifts + 1)
@group(0) @binding(3) var<storage, read> plane_count: array<u32>;
@group(0) @binding(4) var<storage, read_write> cost: array<f32>;  // (h, w, planes)

fn add(at: u32, value: f32) {
    cost[at] = select(cost[at], 0.0, cost[at] > forbidden / 2.0) + value;
}

// What line `number` - 1 says of the grid point that lies `step` - shifts + 1 behind its own.
fn heard(number: u32, step: u32, first: u32) {
    if (number == 0u) { return; }
    let line = lines[number - 1u];
    if (((line.z >> step) & 1u) == 0u) { return; }  // a point of a third plane
    let at = (number - 1u) * (2u * shifts + 1u) + step;
    let rise = 0.5 * bitcast<f32>(line.w) * (costs[at + 1u] - costs[at]);
    let near_first = (line.z >> 31u) == 1u;
    add(first + line.x, select(-rise, rise, near_first));
    add(first + line.y, select(rise, -rise, near_first));
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let first = i * plane_count[0];
    for (var step = 0u; step < 2u * shifts; step++) {
        let back = i32(step) - i32(shifts) + 1i;
        let x = i32(i % width) - back;
        let y = i32(i / width) - back;
        if (x >= 0i && x < i32(width)) { heard(line_at[u32(i32(i) - back)], step, first); }
        if (y >= 0i && y < i32(height)) { heard(line_at[width * height + u32(y) * width + i % width], step, first); }
    }
}
