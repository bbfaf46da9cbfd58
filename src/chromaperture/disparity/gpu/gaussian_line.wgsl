// A filter of 2 reach + 1 taps along one axis of planes (planes, h, w, parts), mirrored at the borders. An invocation has
// four neighbours along the axis, whose pixels overlap.

@group(0) @binding(0) var<storage, read> before: array<f32>;
@group(0) @binding(1) var<storage, read> taps: array<f32>;  // and three zeros
@group(0) @binding(2) var<storage, read_write> after: array<f32>;

const across = select(height, width, along_x);
const fours = (across + 3u) / 4u;
const beside = select(width, 1u, along_x) * parts;  // from one pixel of the axis to the next

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= planes * select(width, height, along_x) * fours * parts) { return; }
    let part = i % parts;
    let rest = i / parts;
    // Neighbouring invocations have neighbouring columns.
    let along = 4u * select(rest / width % fours, rest % fours, along_x);
    let line = select(rest % width * parts, rest / fours % height * width * parts, along_x);
    let plane = rest / select(width * fours, fours * height, along_x);
    let first = plane * width * height * parts + line + part;
    var sum = vec4f();
    var weights = vec4f();  // of the four pixels, for what is read
    for (var k = 0u; k < 2u * reach + 4u; k++) {
        weights = vec4f(taps[k], weights.xyz);
        sum += weights * before[first + mirrored(i32(along + k) - i32(reach), across) * beside];
    }
    for (var n = 0u; n < min(4u, across - along); n++) { after[first + (along + n) * beside] = sum[n]; }
}
