// The transform of `cross_rows.wgsl` along the columns: P and Q of the middle of every tile.

@group(0) @binding(1) var<storage, read> rows: array<vec2f>;  // (layers of a round, tiles, pairs, span, middle)
@group(0) @binding(2) var<storage, read_write> views: array<vec2f>;  // (..., middle, middle)

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let first = (group.x + group.y * groups.x) * lines_of_group;
    for (var i = local; i < lines_of_group * span; i += 128u) {
        // Neighbouring invocations read neighbouring columns.
        let column = min(first + i % lines_of_group, lines - 1u);
        let y = i / lines_of_group;
        line[i % lines_of_group * span + y] = rows[(column / middle * span + y) * middle + column % middle];
    }
    let start = transformed(local);
    for (var i = local; i < lines_of_group * middle; i += 128u) {
        let column = first + i % lines_of_group;
        let y = i / lines_of_group;
        if (column < lines) {
            let at = start + i % lines_of_group * span + (span - middle) / 2u + y;
            views[(column / middle * middle + y) * middle + column % middle] = line[at] / f32(span * span);
        }
    }
}
