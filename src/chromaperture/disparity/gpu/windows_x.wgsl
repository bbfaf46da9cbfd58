// Mean and variance of the samples in a window along x: weights decay^|x|, normalised, the picture continued beyond its
// border. Two recursions one after the other (West 1979), forward over the samples, then backward over what it leaves.
// They are of deviations from the mean so far: E[v^2] - E[v]^2 would lose what little texture a bright even area has to
// the rounding of 32 bits. The deviations go out, times sqrt(decay (1 - decay)): with them a covariance of two views
// needs no means of its own (`products_x.wgsl`). One invocation takes `block` columns; its recursions start `reach`
// beside them as if the picture were even from there on. Deviations fade `reach` columns beyond the right border.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (rows, columns, E)
@group(0) @binding(1) var<storage, read_write> windows: array<vec2f>;  // (rows, columns, E): mean, variance
@group(0) @binding(2) var<storage, read_write> deviations: array<vec2f>;  // (rows, columns + reach, E): forward, backward

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let length = columns + reach;
    let blocks = (length + block - 1u) / block;
    if (i >= row_count * blocks * entry_count) { return; }
    let e = i % entry_count;
    let row = i / (blocks * entry_count);
    let first = ((i / entry_count) % blocks) * block;
    let end = min(first + block, length);
    let last = min(end + reach, length) - 1u;
    var ahead: array<vec3f, block + reach>;  // mean, variance, forward deviation
    let begin = max(first, reach) - reach;
    var mean = samples[(row * columns + min(begin, columns - 1u)) * entry_count + e];
    var variance = 0.0;
    for (var x = begin; x <= last; x++) {
        let apart = samples[(row * columns + min(x, columns - 1u)) * entry_count + e] - mean;
        mean += (1.0 - decay) * apart;
        variance = decay * (variance + (1.0 - decay) * apart * apart);
        if (x >= first) { ahead[x - first] = vec3f(mean, variance, apart); }
    }
    for (var x = last + 1u; x > first; x--) {
        let here = ahead[x - 1u - first];
        let apart = here.x - mean;
        mean += (1.0 - decay) * apart;
        variance = decay * (variance + (1.0 - decay) * apart * apart) + (1.0 - decay) * here.y;
        if (x <= end) {
            deviations[(row * length + x - 1u) * entry_count + e] = deviation_unit * vec2f(here.z, apart);
            if (x <= columns) { windows[(row * columns + x - 1u) * entry_count + e] = vec2f(mean, variance); }
        }
    }
}
