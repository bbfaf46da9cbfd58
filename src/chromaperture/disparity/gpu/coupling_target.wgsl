// The v that minimises (v - u)^2 / 2 - fidelity theta l(v) at every pixel, between layers by a parabola through
// exp(-l); see `stages/variation.py`. The greatest log-likelihood of the pixel tells how far from u it can be.

@group(0) @binding(0) var<storage, read> variation: array<vec4f>;
@group(0) @binding(1) var<storage, read> likelihood: array<f32>;  // (h, w, count)
@group(0) @binding(2) var<storage, read> winner: array<vec4f>;
@group(0) @binding(3) var<storage, read> couplings: array<f32>;  // theta of every round
@group(0) @binding(4) var<storage, read> round: array<u32>;
@group(0) @binding(5) var<storage, read_write> goal: array<f32>;  // (h, w), layers

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let at = pixel * count;
    let gain = couplings[round[0]] * fidelity;
    let u = variation[pixel].x;
    let last = f32(count - 1u);
    let near = clamp(round_to(u), 0.0, last);
    let known = (near - u) * (near - u) / 2.0 - gain * likelihood[at + u32(near)];
    let radius = sqrt(max(2.0 * (known + gain * winner[pixel].w), 0.0)) + 1.0e-3;  // 1e-3 layers: rounding
    let from_layer = u32(clamp(ceil(u - radius), 0.0, near));
    let to_layer = u32(clamp(floor(u + radius), near, last));
    var best = from_layer;
    var least = 1.0e30;
    for (var k = from_layer; k <= to_layer; k++) {
        let away = f32(k) - u;
        let cost = away * away / 2.0 - gain * likelihood[at + k];
        if (cost < least) {
            least = cost;
            best = k;
        }
    }
    if (best == 0u || best == count - 1u) {
        goal[pixel] = f32(best);
        return;
    }
    let center = likelihood[at + best];
    let before = exp(center - likelihood[at + best - 1u]);
    let after = exp(center - likelihood[at + best + 1u]);
    let slope = (after - before) / 2.0;
    let bend = max((before + after) / 2.0 - 1.0, 0.0);
    let offset = (u - f32(best) - gain * slope) / (1.0 + 2.0 * gain * bend);
    goal[pixel] = f32(best) + clamp(offset, -0.5, 0.5);
}

fn round_to(value: f32) -> f32 {
    return floor(value + 0.5);
}
