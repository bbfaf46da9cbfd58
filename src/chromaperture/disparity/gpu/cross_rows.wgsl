// Two channels of a tile filtered with each other's blur, P and Q as the real and the imaginary part of one spectrum,
// and its transform back along the rows; see `blur_evidence.py`.

@group(0) @binding(1) var<storage, read> spectra: array<vec2f>;  // (tiles, 3, span, columns)
@group(0) @binding(2) var<storage, read> signal_share: array<f32>;  // alike
@group(0) @binding(3) var<storage, read> transfers: array<vec2f>;  // (layers of a round, tiles, channels, span, columns)
@group(0) @binding(4) var<storage, read> low_pass: array<f32>;  // (span,)
@group(0) @binding(5) var<storage, read_write> rows: array<vec2f>;  // (layers of a round, tiles, pairs, span, middle)

const columns = span / 2u + 1u;

// P + i Q at a frequency, or at its negative.
fn filtered(tile: u32, layer: u32, pair: u32, y: u32, x: u32, negative: bool) -> vec2f {
    let packed = pairs >> (8u * pair);  // both channels, and where they are among those of the transfer functions
    let a = packed & 3u;
    let b = (packed >> 2u) & 3u;
    let at_a = (tile * 3u + a) * span * columns + y * columns + x;
    let at_b = (tile * 3u + b) * span * columns + y * columns + x;
    let place = (layer * tiles + tile) * channels;
    let blur_a = transfers[(place + ((packed >> 4u) & 3u)) * span * columns + y * columns + x];
    let blur_b = transfers[(place + ((packed >> 6u) & 3u)) * span * columns + y * columns + x];
    let power = (dot(blur_a, blur_a) + dot(blur_b, blur_b)) * 0.5;
    let gain = low_pass[y] * low_pass[x] * min(signal_share[at_a], signal_share[at_b]) * inverseSqrt(power + damping);
    let p = product(spectra[at_a], blur_b) * gain;
    let q = product(spectra[at_b], blur_a) * gain;
    return select(vec2f(p.x - q.y, p.y + q.x), vec2f(p.x + q.y, q.x - p.y), negative);
}

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let first = (group.x + group.y * groups.x) * lines_of_group;
    for (var i = local; i < lines_of_group * span; i += 128u) {
        let row = min(first + i / span, lines - 1u);
        let x = i % span;
        let y = row % span;
        let pair = row / span % pair_count;
        let tile = row / (span * pair_count) % tiles;
        let layer = row / (span * pair_count * tiles);
        let negative = x >= columns;
        line[i] = filtered(
            tile, layer, pair, select(y, (span - y) % span, negative), select(x, span - x, negative), negative
        );
    }
    let start = transformed(local);
    for (var i = local; i < lines_of_group * middle; i += 128u) {
        let row = first + i / middle;
        let at = start + i / middle * span + (span - middle) / 2u + i % middle;
        if (row < lines) { rows[row * middle + i % middle] = line[at]; }
    }
}
