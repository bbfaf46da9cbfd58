// A filter of 2 reach + 1 taps along one axis of planes (planes, h, w, parts), mirrored at the borders. An invocation
// has eight neighbours on the axis, whose pixels overlap.

@group(0) @binding(0) var<storage, read> before: array<f32>;
@group(0) @binding(1) var<storage, read> taps: array<f32>;  // and 7 zeros
@group(0) @binding(2) var<storage, read_write> after: array<f32>;

const across = select(height, width, along_x);
const eights = (across + 7u) / 8u;
const beside = select(width, 1u, along_x) * parts;  // from one pixel of the axis to the next

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= planes * select(width, height, along_x) * eights * parts) { return; }
    let part = i % parts;
    let rest = i / parts;
    // Neighbouring invocations have neighbouring columns.
    let along = 8u * select(rest / width % eights, rest % eights, along_x);
    let line = select(rest % width, rest / eights % height, along_x) * parts;
    let plane = rest / select(width * eights, eights * height, along_x);
    let first = plane * width * height * parts + line * select(1u, width, along_x) + part;
    var near = vec4f();  // of the first four and of the others: sums, and weights for what is read
    var far = vec4f();
    var near_weights = vec4f();
    var far_weights = vec4f();
    for (var k = 0u; k < 2u * reach + 8u; k++) {
        far_weights = vec4f(near_weights.w, far_weights.xyz);
        near_weights = vec4f(taps[k], near_weights.xyz);
        let here = before[first + mirrored(i32(along + k) - i32(reach), across) * beside];
        near += near_weights * here;
        far += far_weights * here;
    }
    for (var n = 0u; n < 4u; n++) {
        if (along + n < across) { after[first + (along + n) * beside] = near[n]; }
        if (along + n + 4u < across) { after[first + (along + n + 4u) * beside] = far[n]; }
    }
}
