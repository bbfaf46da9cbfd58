// The evidence of every block along the answer, and along the answer shifted; see `evidence_signs.py`.

@group(0) @binding(0) var<storage, read> blocks: array<f32>;  // (h / block, w / block, count), sums
@group(0) @binding(1) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(2) var<storage, read> shifts: array<f32>;
@group(0) @binding(3) var<storage, read_write> profile: array<f32>;  // (h / block, w / block, shifts), nats a pixel
@group(0) @binding(4) var<storage, read_write> copy: array<f32>;  // the same, to be filtered

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let across = width / block;
    if (i >= across * (height / block) * shift_count) { return; }
    let at = i / shift_count;
    let middle = (at / across * block + block / 2u) * width + at % across * block + block / 2u;
    let place = clamp(surface[middle].x + shifts[i % shift_count], 0.0, f32(count - 1u));
    let below = min(u32(place), count - 2u);
    let low = blocks[at * count + below];
    let here = low + (place - f32(below)) * (blocks[at * count + below + 1u] - low);
    profile[i] = here / f32(block * block);
    copy[i] = profile[i];
}
