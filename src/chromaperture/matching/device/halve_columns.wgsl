// Every second row of the planes behind the pyramid filter; views in whole units of light. One invocation takes four neighbours, whose rows overlap.

@group(0) @binding(0) var<storage, read> tall: array<f32>;  // (planes, H, w)
@group(0) @binding(1) var<storage, read> stats: array<f32>;
@group(0) @binding(2) var<storage, read_write> planes: array<f32>;  // (planes, h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let each = (height + 3u) / 4u;  // invocations of a column
    if (i >= plane_count * each * width) { return; }
    let x = i % width;
    let first = 4u * ((i / width) % each);
    let plane = i / (width * each);
    let column = plane * tall_height * width + x;
    let is_view = plane < view_count;
    var a = tall[column + mirrored(2i * i32(first) - 2i, tall_height) * width];
    var b = tall[column + mirrored(2i * i32(first) - 1i, tall_height) * width];
    var c = tall[column + mirrored(2i * i32(first), tall_height) * width];
    for (var y = first; y < min(first + 4u, height); y++) {
        let d = tall[column + mirrored(2i * i32(y) + 1i, tall_height) * width];
        let e = tall[column + mirrored(2i * i32(y) + 2i, tall_height) * width];
        let sum = 0.0625 * a + 0.25 * b + 0.375 * c + 0.25 * d + 0.0625 * e;
        planes[(plane * height + y) * width + x] = select(sum, stats[UNIT] * round(stats[UNIT + 1u] * sum), is_view);
        a = c;
        b = d;
        c = e;
    }
}
