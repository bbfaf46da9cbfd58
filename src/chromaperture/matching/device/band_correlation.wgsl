// Correlation of P and Q in windows, from their averaged products. Detail that blur brings from elsewhere is taken off.

@group(0) @binding(0) var<storage, read> products: array<f32>;  // (bands, layers of a round, pairs, h, w, 3)
@group(0) @binding(1) var<storage, read> seen: array<vec2f>;  // (bands, all pairs, h, w): powers in focus
@group(0) @binding(2) var<storage, read> round: array<u32>;
@group(0) @binding(3) var<storage, read_write> correlation: array<f32>;  // see `correlations.wgsl`

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= bands * layers_of_round * pair_count * width * height) { return; }
    let pixel = i % (width * height);
    let pair = i / (width * height) % pair_count;
    let layer = first_layer + round[0] * layers_of_round + i / (width * height * pair_count) % layers_of_round;
    let band = i / (width * height * pair_count * layers_of_round);
    let x = pixel % width;
    let y = pixel / width;
    if (layer >= layer_count || x >= kept_width || y >= kept_height) { return; }
    let powers = vec2f(products[3u * i + 1u], products[3u * i + 2u]);
    var found = products[3u * i] * inverseSqrt(powers.x * powers.y + least_power);
    if (takes_off != 0u) {
        let own = seen[(band * all_pairs + pair) * width * height + pixel];
        let growth = max(vec2f(1.0), powers / (allowed_growth * (own + least_seen)));
        found /= growth.x * growth.y;
    }
    correlation[correlations_of(pair, band, kept_width * kept_height, y * kept_width + x) + layer] = found;
}
