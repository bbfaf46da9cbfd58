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
