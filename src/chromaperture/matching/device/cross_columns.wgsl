// Two channels of a tile filtered with each other's blur, P and Q, transformed back along the columns; see
// `blur_evidence.py`. Frequencies of half a cycle a sample are left out.

@group(0) @binding(1) var<storage, read> pair_spectra: array<vec4f>;  // (tiles, all pairs, span, kept)
@group(0) @binding(2) var<storage, read> transfers: array<vec2f>;  // (layers of a round, tiles, channels, span, kept)
// (layers of a round, tiles, pairs, middle, kept): P and Q of the middle rows
@group(0) @binding(3) var<storage, read_write> columns: array<vec4f>;

const kept = span / 2u;

fn taken(line: u32, y: u32) -> vec4f {
    let pair = line / kept % pair_count;
    let picture = line / (kept * pair_count);
    let place = y * kept + line % kept;
    let packed = pairs >> (4u * pair);  // where both channels are among those of the transfer functions
    let both = pair_spectra[((picture % tiles * all_pairs + pair) * span + y) * kept + line % kept];
    let blur_a = transfers[(picture * channels + (packed & 3u)) * span * kept + place];
    let blur_b = transfers[(picture * channels + ((packed >> 2u) & 3u)) * span * kept + place];
    let gain = inverseSqrt((dot(blur_a, blur_a) + dot(blur_b, blur_b)) * 0.5 + damping);
    return vec4f(times(both.xy, blur_b), times(both.zw, blur_a)) * gain;
}

fn given(line: u32, y: u32, value: vec4f) {
    let row = y - (span - middle) / 2u;
    if (row < middle) { columns[(line / kept * middle + row) * kept + line % kept] = value; }
}

@compute @workgroup_size(group_size)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    transform((group.x + group.y * groups.x) * lines_of_group, local);
}
