//! The options of pictures, which commands that write maps share.

use crate::error::Result;
use crate::model::SceneIr;
use crate::result::png::{Style, Unit};

/// How pictures show maps. The numbers of a result are the same whatever is given here.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct PictureArgs {
    /// Write no pictures, only numbers.
    #[arg(long, requires = "output")]
    no_pictures: bool,
    /// Colours of pictures: linear from zero, or logarithmic, which shows faint light beside bright light.
    #[arg(long, value_enum, value_name = "SCALE", requires = "output")]
    scale: Option<ScaleArg>,
    /// Unit of pictures, such as W/m2, mW/cm2, mW/mm2 or mW/sr; of photometric results also lx, fc, cd. By default lx and cd
    /// where results are photometric, else W/mm2 and W/sr, with the prefix that fits.
    #[arg(long, value_name = "UNIT", requires = "output")]
    unit: Option<Unit>,
    /// Pictures of far fields: a disc of directions, or the polar diagram of a luminaire.
    #[arg(long, value_enum, value_name = "KIND", requires = "output")]
    far_fields: Option<FarFieldArg>,
}

/// The `--far-fields` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum FarFieldArg {
    /// Colours over directions, as seen along the axis.
    Disc,
    /// Intensity over the polar angle, in the planes C0-C180 and C90-C270.
    Polar,
}

/// The `--scale` argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ScaleArg {
    /// Linear from zero to the largest value.
    Linear,
    /// Logarithmic, over six decades at most below the largest value.
    Log,
}

impl PictureArgs {
    /// The style of pictures of a scene, whose results may be photometric, if any are wanted.
    pub(crate) fn style(self, ir: &SceneIr, is_photometric: bool) -> Result<Option<Style>> {
        let is_polar = self.far_fields == Some(FarFieldArg::Polar);
        let style = Style { is_log: self.is_log(), unit: self.unit, is_polar };
        style.check(ir, is_photometric)?;
        Ok(Some(style).filter(|_| !self.no_pictures))
    }

    /// True if colours are logarithmic.
    pub(crate) fn is_log(self) -> bool {
        self.scale == Some(ScaleArg::Log)
    }
}
