// The best layer of every pixel by the sum of its path costs, how sharp it is, and where between the layers the pixel's
// own correlations have their peak.

@group(0) @binding(0) var<storage, read> likelihood: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(1) var<storage, read> rightward: array<vec2u>;
@group(0) @binding(2) var<storage, read> leftward: array<vec2u>;
@group(0) @binding(3) var<storage, read> downward: array<vec2u>;
@group(0) @binding(4) var<storage, read> upward: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> winner: array<f32>;  // (3, h, w): layer, likelihood there, sigma in layers
@group(0) @binding(6) var<storage, read_write> places: array<vec2f>;  // (h, w): information, place times information

fn likelihood_of(pixel: u32, layer: u32) -> f32 {
    return likelihood[pixel * (pitch / 4u) + layer / 4u][layer % 4u];
}

// The correlation behind a log-likelihood.
fn correlation_of(nats: f32) -> f32 {
    if (view_count == 2u) { return sqrt(max(1.0 - exp(-2.0 * nats), 0.0)); }
    return 1.0 - exp(-nats);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    var costs: array<vec4f, pitch / 4u>;
    var least = 1.0e30;
    var best = 0u;
    for (var v = 0u; v < pitch / 4u; v++) {
        let at = pixel * (pitch / 4u) + v;
        let others = unpacked(rightward[at]) + unpacked(leftward[at]) + unpacked(downward[at]);
        let cost = others / row_parts + (unpacked(upward[at]) / cost_parts - likelihood[at]);
        costs[v] = cost;
        for (var j = 0u; j < 4u; j++) {
            if (cost[j] < least) {
                least = cost[j];
                best = 4u * v + j;
            }
        }
    }
    var weights = 0.0;
    var squares = 0.0;
    for (var v = 0u; v < pitch / 4u; v++) {
        var weight = max(1.0 - (costs[v] - least) / (8.0 * temperature), vec4f());
        weight *= weight;
        weight *= weight;
        weight *= weight;
        // Layers that only fill the last vector are none. They have no likelihood, so that none of them is the best.
        weight = select(vec4f(), weight, vec4u(0u, 1u, 2u, 3u) + 4u * v < vec4u(layer_count));
        let away = vec4f(0.0, 1.0, 2.0, 3.0) + f32(4u * v) - f32(best);
        weights += dot(weight, vec4f(1.0));
        squares += dot(weight, away * away);
    }
    let middle = clamp(best, 1u, layer_count - 2u);
    let at = likelihood_of(pixel, middle);
    winner[pixel] = f32(best);
    winner[width * height + pixel] = at;
    winner[2u * width * height + pixel] = sqrt(squares / weights);

    let low = correlation_of(likelihood_of(pixel, middle - 1u));
    let here = correlation_of(at);
    let high = correlation_of(likelihood_of(pixel, middle + 1u));
    var offset = 0.0;
    var information = least_information;
    if (view_count == 2u) {
        let bend = max(2.0 * here - low - high, 0.0);
        offset = clamp((high - low) / (2.0 * bend + 1.0e-9), -1.0, 1.0);  // 1e-9: a flat top has no vertex
        let peak = min(here + offset * (high - low) / 4.0, 1.0);
        let found = bend * peak / (1.0 - peak * peak + least_unexplained);
        information += found * sqrt(sqrt(found));
    } else {
        // Where the range ends one layer away the parabola through the three others goes on.
        var far_low = 3.0 * (low - here) + high;
        var far_high = 3.0 * (high - here) + low;
        if (middle > 1u) { far_low = correlation_of(likelihood_of(pixel, middle - 2u)); }
        if (middle < layer_count - 2u) { far_high = correlation_of(likelihood_of(pixel, middle + 2u)); }
        let rise = (2.0 * (far_high - far_low) + high - low) / 5.0;
        let least_bend = abs(rise) / (2.0 * farthest_of_five);
        let bend = max((2.0 * here + low + high - 2.0 * (far_low + far_high)) / 7.0, least_bend);
        offset = rise / (2.0 * bend + 1.0e-9);
        information += bend * here / (1.0 - here + least_unexplained_of_three);
    }
    places[pixel] = vec2f(information, (f32(middle) + offset) * information);
}
