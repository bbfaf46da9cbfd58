// Spectra of both channels of every pair, without what is noise in either, smoothed by the finest Gaussian of all bands:
// what P and Q have at all depths alike, divided by the numbers of a tile.

@group(0) @binding(0) var<storage, read> spectra: array<vec2f>;  // (tiles, 3, span, span / 2 + 1)
@group(0) @binding(1) var<storage, read> signal_share: array<f32>;  // alike
@group(0) @binding(2) var<storage, read> low_pass: array<f32>;  // (span,)
@group(0) @binding(3) var<storage, read_write> pair_spectra: array<vec4f>;  // (tiles, pairs, span, kept)

const kept = span / 2u;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= tiles * pair_count * span * kept) { return; }
    let x = i % kept;
    let y = i / kept % span;
    let packed = pairs >> (4u * (i / (kept * span) % pair_count));
    let tile = i / (kept * span * pair_count);
    let at_a = ((tile * 3u + (packed & 3u)) * span + y) * (kept + 1u) + x;
    let at_b = ((tile * 3u + ((packed >> 2u) & 3u)) * span + y) * (kept + 1u) + x;
    let gain = low_pass[y] * low_pass[x] * min(signal_share[at_a], signal_share[at_b]) / f32(span * span);
    pair_spectra[i] = vec4f(spectra[at_a], spectra[at_b]) * gain;
}
