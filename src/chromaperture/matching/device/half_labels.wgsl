// Labels of equal depth at a pixel of the halved picture or at a cell of it, every `label_spacing` px of the full one:
// offset in px of the halved one, scale; `labels` has those of the full one.

fn half_label(x: u32, y: u32) -> vec2f {
    if (!labelled) { return vec2f(0.0, 1.0); }
    let at = label_spacing * (y * full_width + x);
    return vec2f(labels[at] / 2.0, labels[full_width * full_height + at]);
}
