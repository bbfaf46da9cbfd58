// The logarithm of the learned error bar, a weighted sum of signs; see `learned_error_bar.py`. Signs count in layers.

@group(0) @binding(0) var<storage, read> pooled: array<f32>;  // (h, w): variance of the posterior
@group(0) @binding(1) var<storage, read> of_planes: array<f32>;  // (planes,): share that is rejected
@group(0) @binding(2) var<storage, read> evidence_of: array<vec2f>;  // (planes,): see `sums_of_blocks.wgsl`
@group(0) @binding(3) var<storage, read> of_blocks: array<vec2f>;  // (h, w): how far fits lie apart, spread
@group(0) @binding(4) var<storage, read> of_frame: array<f32>;  // mean sign of the posterior
@group(0) @binding(5) var<storage, read_write> bar: array<u32>;  // (h, w): the plane's number, then the logarithm's bits

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let plane = bar[i];
    var sum = constant + weighed(log_of_posterior(pooled[i]), posterior);
    sum += weighed(of_planes[plane], rejected);
    sum += weighed(evidence_of[plane].y, evidence);
    sum += weighed(of_frame[0], posterior_of_frame);
    sum += weighed(of_blocks[i].x, fits);
    sum += weighed(of_blocks[i].y, spread);
    bar[i] = bitcast<u32>(sum);
}
