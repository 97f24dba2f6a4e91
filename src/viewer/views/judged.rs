//! How even, how wide and how strong the light of a detector is, with standard errors.

use crate::format::thousands;
use crate::result::DetectorData;
use crate::result::figures::{Asked, judge, text};
use crate::viewer::model::Subject;
use crate::viewer::state::{App, Judged};
use crate::viewer::views::{quiet, title};
use eframe::egui::{RichText, Ui};
use std::collections::BTreeMap;

/// Figures when they are asked for: they draw 200 noisy maps, which would hold up a trace's pictures.
pub(super) fn figures(app: &mut App, ui: &mut Ui) {
    let Subject::Detector(name) = app.model.subject.clone() else { return };
    let region = app.model.marks().region;
    let Some(result) = app.model.a() else { return };
    let Some(detector) = result.detector(&name) else { return };
    if !matches!(detector.data, DetectorData::Irradiance(_) | DetectorData::FarField(_)) {
        return;
    }
    title(ui, "Figures");
    let asks = ui.button("Figures with errors").on_hover_text(
        "Least, mean and largest value, Emin/Emean, Emin/Emax, widths, beam and field angle: of the detector, and of the region that is marked.",
    );
    if asks.clicked() {
        // Regions of a far field are cones, and a region of the plot is no cone.
        let regions = region.filter(|_| matches!(detector.data, DetectorData::Irradiance(_)));
        let asked = Asked { regions: regions.into_iter().collect(), cells: None };
        let found = judge(result, detector, &asked);
        let text = found.map_or_else(
            |error| error.to_string(),
            |figures| text(&BTreeMap::from([(name.clone(), figures)])),
        );
        app.judged = Some(Judged { detector: name.clone(), region, num_rays: result.num_rays_total, text });
    }
    let now = app.model.a().map_or(0, |result| result.num_rays_total);
    let is_shown = |judged: &&Judged| judged.detector == name && judged.region == region;
    let Some(judged) = app.judged.as_ref().filter(is_shown) else { return };
    ui.label(RichText::new(judged.text.trim_end()).monospace().size(11.0));
    if judged.num_rays != now {
        let rays = format!("of {} rays; ask again for more", thousands(judged.num_rays));
        ui.label(quiet(ui, rays));
    }
}
