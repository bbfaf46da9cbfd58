// Takes the planes where they are trusted or lie within `within` layers of the surface that they explain, else the
// surface; see `plane_trust.py`.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> counts: array<vec2u>;  // (planes,): pixels, of which the surface is apart
@group(0) @binding(2) var<storage, read> pooled: array<vec2f>;  // (h, w): variance, share where the plane is allowed
@group(0) @binding(3) var<storage, read> steps: array<f32>;  // (h, w): of the surface, layers
@group(0) @binding(4) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(5) var<storage, read_write> surface: array<vec4f>;  // (h, w): layer first

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let plane = vec2f(counts[choice[i]]);
    let log_odds = constant + rough * log(steps[i] + least) + posterior * log(sqrt(pooled[i].x) + least)
        + rejected * plane.y / plane.x + agreed * pooled[i].y;
    if (log_odds > 0.0 || abs(there[i] - surface[i].x) <= within) { surface[i].x = there[i]; }
}
