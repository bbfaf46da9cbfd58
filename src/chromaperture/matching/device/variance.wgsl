// Variance of every view over the picture. This stage sums parts of it, `variance_sum.wgsl` the parts.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (planes, h, w), the views first
@group(0) @binding(1) var<storage, read_write> parts: array<f32>;  // (groups, 6)

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    var own = Sums();
    for (var i = group.x * 256u + local; i < pixels; i += part_count * 256u) {
        for (var k = 0u; k < view_count; k++) {  // unrolled
            let value = planes[k * pixels + i];
            own.values[k] += value;
            own.squares[k] += value * value;
        }
    }
    let total = summed(own, local);
    if (local == 0u) {
        for (var k = 0u; k < 3u; k++) {
            parts[6u * group.x + k] = total.values[k];
            parts[6u * group.x + 3u + k] = total.squares[k];
        }
    }
}
