//! How pictures show values: in linear or logarithmic colours, and in which unit. No number in a file depends on it.

use crate::error::{Error, Result};
use crate::format::si_prefix;
use crate::model::SceneIr;
use crate::result::picture::scale::ScaleKind;
use std::fmt;
use std::str::FromStr;

/// How pictures show values. By default colours are linear, and units have the prefix that fits.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Style {
    /// Equal ratios look equally far apart, over six decades at most.
    pub is_log: bool,
    /// The unit of the maps that have such a unit; maps of others keep theirs.
    pub unit: Option<Unit>,
    /// Far fields are polar diagrams: intensity over the polar angle in planes C.
    pub is_polar: bool,
}

/// A unit of irradiance or of intensity, such as mW/cm2 or W/sr, or of what the eye sees of it, such as lx.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    prefix: (&'static str, f64),
    per: Per,
}

/// What a watt is divided by, or what the eye sees of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Per {
    SquareMillimetre,
    SquareCentimetre,
    SquareMetre,
    Steradian,
    Lux,
    FootCandle,
    Candela,
}

/// Prefixes, as users write them.
const PREFIXES: [(&str, &str, f64); 10] = [
    ("", "", 1.0),
    ("m", "m", 1e-3),
    ("u", "µ", 1e-6),
    ("µ", "µ", 1e-6),
    ("n", "n", 1e-9),
    ("p", "p", 1e-12),
    ("f", "f", 1e-15),
    ("k", "k", 1e3),
    ("M", "M", 1e6),
    ("G", "G", 1e9),
];

impl Per {
    const ALL: [(&str, Per); 7] = [
        ("W/mm²", Per::SquareMillimetre),
        ("W/cm²", Per::SquareCentimetre),
        ("W/m²", Per::SquareMetre),
        ("W/sr", Per::Steradian),
        ("lx", Per::Lux),
        ("fc", Per::FootCandle),
        ("cd", Per::Candela),
    ];

    /// The unit that results have of this quantity, and how many of those one watt per this is.
    fn base(self) -> (&'static str, f64) {
        match self {
            Per::SquareMillimetre => ("W/mm²", 1.0),
            Per::SquareCentimetre => ("W/mm²", 1e-2),
            Per::SquareMetre => ("W/mm²", 1e-6),
            Per::Steradian => ("W/sr", 1.0),
            Per::Lux => ("lx", 1.0),
            // A lumen per square foot.
            Per::FootCandle => ("lx", 1.0 / (0.3048 * 0.3048)),
            Per::Candela => ("cd", 1.0),
        }
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Per::ALL.iter().find(|(_, per)| *per == self.per).map_or("", |(name, _)| name);
        write!(f, "{}{name}", self.prefix.0)
    }
}

impl FromStr for Unit {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let text_of = text.replace("^2", "²").replace('2', "²");
        let parts = Per::ALL.into_iter().find_map(|(name, per)| {
            let prefix = text_of.strip_suffix(name)?;
            let (_, shown, factor) = PREFIXES.into_iter().find(|(written, ..)| *written == prefix)?;
            Some(Unit { prefix: (shown, factor), per })
        });
        parts.ok_or_else(|| {
            format!(
                "`{text}` is no unit of a map; write W/mm2, W/cm2, W/m2, W/sr, lx, fc or cd, with a prefix such as in mW/cm2"
            )
        })
    }
}

impl Style {
    /// The kind of scale of values that are not negative.
    pub(super) fn scale(self) -> ScaleKind {
        if self.is_log { ScaleKind::Log } else { ScaleKind::Linear }
    }

    /// The unit of values up to `top`, in which results have the unit `base`: how many of those it is, and its name.
    pub(super) fn unit_of(self, base: &str, top: f64) -> (f64, String) {
        match self.unit {
            Some(unit) if unit.per.base().0 == base => (unit.prefix.1 * unit.per.base().1, unit.to_string()),
            _ => {
                let (factor, prefix) = si_prefix(top);
                (factor, format!("{prefix}{base}"))
            }
        }
    }

    /// True if somebody asks for a unit of watts.
    pub(super) fn is_in_watts(self) -> bool {
        self.unit.is_some_and(|unit| unit.per.base().0.starts_with('W'))
    }

    /// Refuses a unit that no map of a scene has, whose results may be photometric.
    ///
    /// # Errors
    /// [`Error::Usage`] with the units that there are.
    pub fn check(self, ir: &SceneIr, is_photometric: bool) -> Result<()> {
        let Some(unit) = self.unit else { return Ok(()) };
        let any = |has_grid: bool| {
            ir.detectors
                .iter()
                .any(|detector| detector.num_cells() > 0 && detector.kind.grid().is_some() == has_grid)
        };
        let has = |base: &str| match base {
            "W/sr" => any(false),
            "cd" => is_photometric && any(false),
            "lx" => is_photometric && any(true),
            _ => any(true),
        };
        let base = unit.per.base().0;
        if has(base) {
            return Ok(());
        }
        let others: Vec<&str> = [("W/mm²", "W/mm2"), ("W/sr", "W/sr"), ("lx", "lx"), ("cd", "cd")]
            .into_iter()
            .filter_map(|(base, written)| has(base).then_some(written))
            .collect();
        let remedy = match others.as_slice() {
            _ if !base.starts_with('W') && !is_photometric => "trace with --photometric".into(),
            [] => "leave --unit out: no detector has a map".into(),
            others => format!("give a unit such as {}", others.join(" or ")),
        };
        Err(Error::Usage(format!("--unit {unit}: no detector's map is in such a unit; {remedy}")))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn units_are_what_their_names_say() {
        // One sun, 1 kW/m2, is 1e-3 W/mm2.
        for (text, name, number) in [
            ("W/m2", "W/m²", 1000.0),
            ("kW/m^2", "kW/m²", 1.0),
            ("mW/cm2", "mW/cm²", 100.0),
            ("mW/mm²", "mW/mm²", 1.0),
            ("uW/mm2", "µW/mm²", 1000.0),
        ] {
            let unit: Unit = text.parse().unwrap();
            let (factor, shown) =
                Style { unit: Some(unit), is_log: false, is_polar: false }.unit_of("W/mm²", 1e-3);
            assert_eq!(shown, name);
            assert_relative_eq!(1e-3 / factor, number, max_relative = 1e-12);
        }
        let per_steradian = Style { unit: Some("mW/sr".parse().unwrap()), is_log: false, is_polar: false };
        assert_eq!(per_steradian.unit_of("W/sr", 5.0), (1e-3, "mW/sr".into()));
        assert_eq!(
            per_steradian.unit_of("W/mm²", 5e-6),
            (1e-6, "µW/mm²".into()),
            "another quantity keeps its own"
        );
        for (text, base, number) in
            [("lx", "lx", 1076.4), ("klx", "lx", 1.0764), ("fc", "lx", 100.0), ("cd", "cd", 1076.4)]
        {
            let unit: Unit = text.parse().unwrap();
            let (factor, shown) = Style { unit: Some(unit), ..Style::default() }.unit_of(base, 1.0);
            assert_eq!(shown, text);
            assert_relative_eq!(1076.4 / factor, number, max_relative = 1e-4);
        }
        for wrong in ["W", "lux", "W/m", "W/mm3", "xW/m2", "", "W/m22"] {
            assert!(wrong.parse::<Unit>().unwrap_err().contains("W/cm2"), "{wrong}");
        }
    }
}
