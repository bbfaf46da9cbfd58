// The plane of every block for which most of the fits' probability speaks, and whether more speaks for it than for the
// surface; see `plane_voting.py`.

@group(0) @binding(0) var<storage, read> choices: array<u32>;  // (fits, h, w), of blocks
@group(0) @binding(1) var<storage, read> kept: array<vec4f>;  // planes of all fits: layers, of blocks
// (1 + fits, h, w): variance, shares apart; in place of these then the layer of every fit's plane
@group(0) @binding(2) var<storage, read_write> maps: array<f32>;
@group(0) @binding(3) var<storage, read> differences: array<f32>;  // (h, w), layers
@group(0) @binding(4) var<storage, read> heights: array<f32>;  // (h, w): the surface, layers
@group(0) @binding(5) var<storage, read> counts: array<vec2u>;  // (planes,): pixels, of which apart
@group(0) @binding(6) var<storage, read_write> voted: array<u32>;  // (h, w): plane of `kept`
@group(0) @binding(7) var<storage, read_write> trusted: array<u32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let blocks = height * width;
    if (i >= blocks) { return; }
    let of_signs = constant + rough * log(differences[i] + least) + posterior * log(sqrt(maps[i]) + least);
    let middle = vec4f(f32(i % width), f32(i / width), 1.0, 0.0);
    var places = array<f32, fits + 1u>();
    var shares = array<f32, fits + 1u>();
    var left = 1.0;
    for (var k = 0u; k < fits; k++) {
        let plane = choices[k * blocks + i];
        let counted = vec2f(counts[plane]);
        let log_odds = of_signs + rejected * counted.y / counted.x + agreed * (1.0 - maps[(1u + k) * blocks + i]);
        places[k] = dot(kept[plane], middle);
        maps[(1u + k) * blocks + i] = places[k];
        shares[k] = 1.0 / ((1.0 + exp(-log_odds)) * f32(fits));
        left -= shares[k];
    }
    places[fits] = heights[i];
    shares[fits] = left;
    var speaks = array<f32, fits>();
    var most = 0.0;
    for (var k = 0u; k < fits; k++) {
        speaks[k] = speaking(&places, &shares, places[k]);
        most = max(most, speaks[k]);
    }
    var best = 0u;
    while (speaks[best] < alike * most) { best++; }
    voted[i] = choices[best * blocks + i];
    trusted[i] = select(0u, 1u, most >= speaking(&places, &shares, places[fits]));
}

fn speaking(places: ptr<function, array<f32, fits + 1u>>, shares: ptr<function, array<f32, fits + 1u>>, at: f32) -> f32 {
    var sum = 0.0;
    for (var k = 0u; k <= fits; k++) {
        let away = ((*places)[k] - at) / near;
        sum += (*shares)[k] * exp(-0.5 * away * away);
    }
    return sum;
}
