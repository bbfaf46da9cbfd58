// The mean sign of the posterior of the pixels in the middles of blocks; see `learned_error_bar.signs`. One workgroup.

@group(0) @binding(0) var<storage, read> pooled: array<f32>;  // (h, w): variance of the posterior
@group(0) @binding(1) var<storage, read_write> mean: array<f32>;

var<workgroup> sums: array<f32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let across = width / block;
    let down = height / block;
    var sum = 0.0;
    for (var i = local; i < across * down; i += 256u) {
        sum += log_of_posterior(pooled[(i / across * block + block / 2u) * width + i % across * block + block / 2u]);
    }
    sums[local] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (local < half) { sums[local] += sums[local + half]; }
        workgroupBarrier();
    }
    if (local == 0u) { mean[0] = sums[0] / f32(across * down); }
}
