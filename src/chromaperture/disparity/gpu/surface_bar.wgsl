// The logarithm of the error bar without signs of planes: the learned one, see `learned_error_bar.py`, or that of
// posterior and range in quadrature, see `accurate.judged`. In layers.

@group(0) @binding(0) var<storage, read> pooled: array<f32>;  // (h, w): variance of the posterior
@group(0) @binding(1) var<storage, read> near_range: array<vec4f>;  // (h, w): largest and smallest about the pixel
@group(0) @binding(2) var<storage, read> wide_range: array<vec4f>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> bar: array<u32>;  // (h, w): the logarithm's bits

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let near = near_range[i].x - near_range[i].y;
    let far = wide_range[i].x - wide_range[i].y;
    var sum = log(max(length(vec2f(sqrt(pooled[i]), edge_share * near)), 1.0e-6));  // 1e-6: 0 has no logarithm
    if (learned) {
        sum = constant + weighed(log_of_posterior(pooled[i]), posterior);
        sum += weighed(log(near + 0.1), range_8) + weighed(log(far + 0.1), range_32);
    }
    bar[i] = bitcast<u32>(sum);
}
