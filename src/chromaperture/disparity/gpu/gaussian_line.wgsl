// A filter of 2 reach + 1 taps along one axis of planes (planes, h, w, parts), mirrored at the borders.

@group(0) @binding(0) var<storage, read> before: array<f32>;
@group(0) @binding(1) var<storage, read> taps: array<f32>;
@group(0) @binding(2) var<storage, read_write> after: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= planes * width * height * parts) { return; }
    let part = i % parts;
    let x = (i / parts) % width;
    let y = (i / (parts * width)) % height;
    let plane = i / (parts * width * height) * width * height;
    var sum = 0.0;
    for (var k = 0u; k < 2u * reach + 1u; k++) {
        let step = i32(k) - i32(reach);
        let column = select(x, mirrored(i32(x) + step, width), along_x);
        let row = select(mirrored(i32(y) + step, height), y, along_x);
        sum += taps[k] * before[(plane + row * width + column) * parts + part];
    }
    after[i] = sum;
}
