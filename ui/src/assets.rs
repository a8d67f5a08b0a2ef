//! The files of the page, built into the program. The page loads nothing from other servers.

use std::sync::LazyLock;

/// A file of the page.
pub(crate) struct Asset {
    pub path: &'static str,
    pub media: &'static str,
    pub text: &'static str,
}

/// All files except Plotly.
static ASSETS: [Asset; 7] = [
    Asset { path: "/", media: "text/html; charset=utf-8", text: include_str!("../page/index.html") },
    Asset { path: "/page.css", media: "text/css; charset=utf-8", text: include_str!("../page/page.css") },
    Asset { path: "/page.js", media: JAVASCRIPT, text: include_str!("../page/page.js") },
    Asset { path: "/redraw.js", media: JAVASCRIPT, text: include_str!("../page/redraw.js") },
    Asset { path: "/room.js", media: JAVASCRIPT, text: include_str!("../page/room.js") },
    Asset { path: "/charts.js", media: JAVASCRIPT, text: include_str!("../page/charts.js") },
    Asset { path: "/buttons.js", media: JAVASCRIPT, text: include_str!("../page/buttons.js") },
];

/// The media type of scripts.
pub(crate) const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

/// The file at a path.
pub(crate) fn find(path: &str) -> Option<&'static Asset> {
    ASSETS.iter().find(|asset| asset.path == path)
}

/// Plotly's script, extracted from the script tags that the `plotly` crate returns.
pub(crate) fn plotly() -> &'static str {
    static SCRIPT: LazyLock<String> = LazyLock::new(|| {
        let tags = plotly::Plot::offline_js_sources();
        let script = tags.split_once('>').and_then(|(_, rest)| rest.split_once("</script>"));
        script.map(|(script, _)| script.to_owned()).unwrap_or_default()
    });
    &SCRIPT
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plotly_is_extracted_completely() {
        let script = plotly();
        assert!(script.trim_start().starts_with("/**\n* plotly.js v"));
        assert!(script.len() > 1_000_000 && script.contains("scatter3d") && script.contains("mesh3d"));
    }

    #[test]
    fn the_page_refers_to_no_other_server() {
        for asset in &ASSETS {
            let text = asset.text.replace("http://www.w3.org/2000/svg", "");
            assert!(!text.contains("http://") && !text.contains("https://"), "{}", asset.path);
            assert!(!text.contains("//cdn"), "{}", asset.path);
        }
    }
}
