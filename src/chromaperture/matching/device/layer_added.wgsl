// A blurred layer, linear between its cells, added to the picture where no clearly nearer layer hides it.

@group(0) @binding(0) var<storage, read> blurred: array<vec4f>;  // (cells_tall, cells_wide): light and coverage
@group(0) @binding(1) var<storage, read> before: array<f32>;  // (H, W): coverage by clearly nearer layers
@group(0) @binding(2) var<storage, read> layer: Layer;
@group(0) @binding(3) var<storage, read_write> total: array<vec4f>;  // (H, W)
@group(0) @binding(4) var<storage, read_write> cover: array<f32>;  // (H, W): of this layer, in its box

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= layer.tall * layer.wide) { return; }
    let place = vec2u(i % layer.wide, i / layer.wide);
    let last = vec2f(f32(layer.cells_wide - 1u), f32(layer.cells_tall - 1u));
    let cell = clamp((vec2f(place) + 0.5) / f32(layer.scale) - 0.5, vec2f(), last);
    let low = vec2u(cell);
    let part = cell - vec2f(low);
    let high = min(low + 1u, vec2u(last));
    let above = mix(blurred[low.y * layer.cells_wide + low.x], blurred[low.y * layer.cells_wide + high.x], part.x);
    let below = mix(blurred[high.y * layer.cells_wide + low.x], blurred[high.y * layer.cells_wide + high.x], part.x);
    let value = mix(above, below, part.y);
    let at = (layer.top + place.y) * width + layer.left + place.x;
    total[at] += clamp(1.0 - before[at], 0.0, 1.0) * value;
    cover[at] = value.w;
}
