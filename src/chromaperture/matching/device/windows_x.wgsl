// Mean and variance of the samples in a window along x: weights decay^|x|, normalised, the picture continued beyond its
// border. Two recursions one after the other (West 1979), forward over the samples, then backward over what it leaves.
// They are of deviations from the mean so far: E[v^2] - E[v]^2 would lose what little texture a bright even area has to
// the rounding of 32 bits. The deviations go out, times sqrt(decay (1 - decay)): with them a covariance of two views
// needs no means of its own (`products_x.wgsl`). One invocation takes `block` columns; its recursions start `reach`
// beside them as if the picture were even from there on. Deviations fade `reach` columns beyond the right border.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (rows, columns, E)
@group(0) @binding(1) var<storage, read_write> windows: array<vec2f>;  // (rows, columns + reach, E): mean, variance
@group(0) @binding(2) var<storage, read_write> deviations: array<vec2f>;  // (rows, columns + reach, E): forward, backward

fn joined(state: vec2f, here: vec2f) -> vec2f {
    let apart = here.x - state.x;
    let variance = decay * (state.y + (1.0 - decay) * apart * apart) + (1.0 - decay) * here.y;
    return vec2f(state.x + (1.0 - decay) * apart, variance);
}

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
    let start = row * length * entry_count + e;
    var beyond: array<vec2f, reach>;  // the block, of the forward recursion, whose own part waits in `windows`
    let begin = max(first, reach) - reach;
    var state = vec2f(samples[(row * columns + min(begin, columns - 1u)) * entry_count + e], 0.0);
    for (var x = begin; x <= last; x++) {
        let apart = samples[(row * columns + min(x, columns - 1u)) * entry_count + e] - state.x;
        state.x += (1.0 - decay) * apart;
        state.y = decay * (state.y + (1.0 - decay) * apart * apart);
        if (x >= end) {
            beyond[x - end] = state;
        } else if (x >= first) {
            windows[start + x * entry_count] = state;
            deviations[start + x * entry_count].x = deviation_unit * apart;
        }
    }
    for (var x = last + 1u; x > end; x--) { state = joined(state, beyond[x - 1u - end]); }
    for (var x = end; x > first; x--) {
        let at = start + (x - 1u) * entry_count;
        let here = windows[at];
        deviations[at].y = deviation_unit * (here.x - state.x);
        state = joined(state, here);
        windows[at] = state;
    }
}
