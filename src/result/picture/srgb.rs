//! Colours of a screen, in sRGB. Source: IEC 61966-2-1.

use crate::result::picture::Rgb;

/// Linear sRGB of X, Y and Z, where white has Y = 1.
const LINEAR: [[f64; 3]; 3] = [
    [3.240_454_2, -1.537_138_5, -0.498_531_4],
    [-0.969_266_0, 1.876_010_8, 0.041_556_0],
    [0.055_643_4, -0.204_025_9, 1.057_225_2],
];

/// sRGB of X, Y and Z, where white has Y = 1. A hue beyond sRGB loses its negative channels. Light that is too bright for its
/// hue becomes the brightest of this hue.
pub(crate) fn srgb(xyz: [f64; 3]) -> Rgb {
    let linear =
        LINEAR.map(|row| row.iter().zip(xyz).map(|(factor, value)| factor * value).sum::<f64>().max(0.0));
    let brightest = linear.into_iter().fold(1.0, f64::max);
    linear.map(|channel| {
        let linear = channel / brightest;
        let encoded =
            if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
        (255.0 * encoded).round() as u8
    })
}

/// White light of this brightness, from 0 to 1.
pub(crate) fn white(part: f64) -> Rgb {
    /// X, Y and Z of the white of sRGB (D65).
    const WHITE: [f64; 3] = [0.950_47, 1.0, 1.088_83];
    srgb(WHITE.map(|value| value * part))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White, black, grey and the primaries: their X, Y and Z by the columns of the inverse matrix (IEC 61966-2-1, 5.2).
    #[test]
    fn colours_are_those_of_the_standard() {
        assert_eq!([white(1.0), white(0.0), white(0.214_04)], [[255; 3], [0; 3], [127; 3]]);
        assert_eq!(srgb([0.412_456, 0.212_673, 0.019_334]), [255, 0, 0]);
        assert_eq!(srgb([0.357_576, 0.715_152, 0.119_192]), [0, 255, 0]);
        assert_eq!(srgb([0.180_438, 0.072_175, 0.950_304]), [0, 0, 255]);
        // Beyond sRGB: a spectral green has no red.
        assert_eq!(srgb([0.06, 0.71, 0.16])[0], 0);
    }

    /// Blue of 450 nm is blue at any brightness: X, Y and Z by the CIE 1931 observer.
    #[test]
    fn hue_does_not_depend_on_brightness() {
        let bright = srgb([0.3362, 0.0380, 1.7721].map(|value| value / 0.038));
        for part in [0.9, 0.5, 0.1] {
            assert_eq!(srgb([0.3362, 0.0380, 1.7721].map(|value| value / 0.038 * part)), bright);
        }
        assert!(bright[2] == 255 && bright[0] < 100 && bright[1] == 0, "{bright:?}");
    }
}
