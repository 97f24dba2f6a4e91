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
    /// Unit of pictures, such as W/m2, mW/cm2, mW/mm2 or mW/sr. By default W/mm2 or W/sr, with the prefix that fits.
    #[arg(long, value_name = "UNIT", requires = "output")]
    unit: Option<Unit>,
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
    /// The style of pictures of a scene, if any are wanted.
    pub(crate) fn style(self, ir: &SceneIr) -> Result<Option<Style>> {
        let style = Style { is_log: self.is_log(), unit: self.unit };
        style.check(ir)?;
        Ok(Some(style).filter(|_| !self.no_pictures))
    }

    /// True if colours are logarithmic.
    pub(crate) fn is_log(self) -> bool {
        self.scale == Some(ScaleArg::Log)
    }
}
