// A picture in another focus.

// ---- refocus_layer
// What is known of a layer of `effects/refocusing.py`: an array of whole numbers and floats.

struct Layer {
    below: f32,  // blur radii: of the layer before, its own, of the layer behind
    here: f32,
    above: f32,
    top: u32,  // its box in the picture
    left: u32,
    tall: u32,
    wide: u32,
    scale: u32,  // the box is blurred in cells of so many px a side
    cells_tall: u32,
    cells_wide: u32,
    side: u32,  // of the kernel
}

// ---- layer_reduced: indexing, shared, refocus_layer
// Light and coverage of a layer in its box, 0 where it is absent: means of cells. Beyond the box its last rows and columns
// go on.

in color: array<f32>;  // (H, W, 3)
in behind: array<f32>;  // (H, W, 3): what near surfaces hide
in radius: array<f32>;  // (H, W): new blur of both; far beyond all where nothing is
in behind_radius: array<f32>;  // hidden
in layer: Layer;
out cells: array<vec4f>;  // (cells_tall, cells_wide)

// Linear to the neighbouring layers' radii.
fn weight_of(r: f32) -> f32 {
    if (r <= layer.below || r >= layer.above) { return 0.0; }
    if (r < layer.here) { return (r - layer.below) / (layer.here - layer.below); }
    return (layer.above - r) / (layer.above - layer.here);
}

fn main(i) {
    if (i >= layer.cells_tall * layer.cells_wide) { return; }
    let first = layer.scale * vec2u(i % layer.cells_wide, i / layer.cells_wide);
    var sum = vec4f();
    for (var dy = 0u; dy < layer.scale; dy++) {
        let y = layer.top + min(first.y + dy, layer.tall - 1u);
        for (var dx = 0u; dx < layer.scale; dx++) {
            let at = y * width + layer.left + min(first.x + dx, layer.wide - 1u);
            let a = weight_of(radius[at]);
            let b = weight_of(behind_radius[at]);
            if (a == 0.0 && b == 0.0) { continue; }
            let light = vec3f(color[3u * at], color[3u * at + 1u], color[3u * at + 2u]);
            let hidden = vec3f(behind[3u * at], behind[3u * at + 1u], behind[3u * at + 2u]);
            sum += vec4f(a * light + b * hidden, a + b);
        }
    }
    cells[i] = sum / f32(layer.scale * layer.scale);
}

// ---- layer_blurred: indexing, shared, refocus_layer
// A layer convolved with the pupil's picture, mirrored at the border of its box.

in cells: array<vec4f>;  // (cells_tall, cells_wide)
in kernel: array<f32>;  // (side, side), odd
in layer: Layer;
out blurred: array<vec4f>;  // (cells_tall, cells_wide)

// With the border's own cell (BORDER_REFLECT of OpenCV).
fn reflected(at: i32, count: u32) -> u32 {
    var place = at;
    while (place < 0i || place >= i32(count)) { place = select(2i * i32(count) - 1i - place, -1i - place, place < 0i); }
    return u32(place);
}

fn main(i) {
    if (i >= layer.cells_tall * layer.cells_wide) { return; }
    let reach = i32(layer.side / 2u);
    let x = i32(i % layer.cells_wide) + reach;
    let y = i32(i / layer.cells_wide) + reach;
    var sum = vec4f();
    for (var row = 0u; row < layer.side; row++) {
        let line = reflected(y - i32(row), layer.cells_tall) * layer.cells_wide;
        for (var column = 0u; column < layer.side; column++) {
            let weight = kernel[row * layer.side + column];
            if (weight != 0.0) { sum += weight * cells[line + reflected(x - i32(column), layer.cells_wide)]; }
        }
    }
    blurred[i] = sum;
}

// ---- layer_added: indexing, shared, refocus_layer
// A blurred layer, linear between its cells, added to the picture where no clearly nearer layer hides it.

in blurred: array<vec4f>;  // (cells_tall, cells_wide): light and coverage
in before: array<f32>;  // (H, W): coverage by clearly nearer layers
in layer: Layer;
out total: array<vec4f>;  // (H, W)
out cover: array<f32>;  // (H, W): of this layer, in its box

fn main(i) {
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

// ---- cover_joined: indexing, shared, refocus_layer
// From here on a layer hides what comes behind it.

in cover: array<f32>;  // (H, W): of the layer, in its box
in layer: Layer;
out before: array<f32>;  // (H, W)

fn main(i) {
    if (i >= layer.tall * layer.wide) { return; }
    let at = (layer.top + i / layer.wide) * width + layer.left + i % layer.wide;
    before[at] += cover[at];
}

// ---- light_over_cover: indexing, shared
// Light divided by coverage, not negative.

in total: array<vec4f>;  // (H, W)
out refocused: array<f32>;  // (H, W, 3)

fn main(i) {
    if (i >= pixels) { return; }
    let light = max(total[i].xyz / max(total[i].w, least_cover), vec3f());
    refocused[3u * i] = light.x;
    refocused[3u * i + 1u] = light.y;
    refocused[3u * i + 2u] = light.z;
}
