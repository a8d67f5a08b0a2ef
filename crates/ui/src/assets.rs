//! The files of the page, built into the program. The page loads nothing from other servers.

use std::sync::LazyLock;

/// A file of the page.
pub(crate) struct Asset {
    pub path: &'static str,
    pub media: &'static str,
    pub text: &'static str,
}

/// All files except Plotly.
static ASSETS: [Asset; 24] = [
    Asset { path: "/", media: "text/html; charset=utf-8", text: include_str!("../page/index.html") },
    Asset { path: "/page.css", media: "text/css; charset=utf-8", text: include_str!("../page/page.css") },
    Asset { path: "/camera.js", media: JAVASCRIPT, text: include_str!("../page/camera.js") },
    Asset { path: "/charts.js", media: JAVASCRIPT, text: include_str!("../page/charts.js") },
    Asset { path: "/fairness.js", media: JAVASCRIPT, text: include_str!("../page/fairness.js") },
    Asset { path: "/figures.js", media: JAVASCRIPT, text: include_str!("../page/figures.js") },
    Asset { path: "/geometry.js", media: JAVASCRIPT, text: include_str!("../page/geometry.js") },
    Asset { path: "/heat.js", media: JAVASCRIPT, text: include_str!("../page/heat.js") },
    Asset { path: "/live.js", media: JAVASCRIPT, text: include_str!("../page/live.js") },
    Asset { path: "/motion.js", media: JAVASCRIPT, text: include_str!("../page/motion.js") },
    Asset { path: "/orders.js", media: JAVASCRIPT, text: include_str!("../page/orders.js") },
    Asset { path: "/outages.js", media: JAVASCRIPT, text: include_str!("../page/outages.js") },
    Asset { path: "/page.js", media: JAVASCRIPT, text: include_str!("../page/page.js") },
    Asset { path: "/plan2d.js", media: JAVASCRIPT, text: include_str!("../page/plan2d.js") },
    Asset { path: "/redraw.js", media: JAVASCRIPT, text: include_str!("../page/redraw.js") },
    Asset { path: "/room.js", media: JAVASCRIPT, text: include_str!("../page/room.js") },
    Asset { path: "/scene.js", media: JAVASCRIPT, text: include_str!("../page/scene.js") },
    Asset { path: "/sentence.js", media: JAVASCRIPT, text: include_str!("../page/sentence.js") },
    Asset { path: "/shapes.js", media: JAVASCRIPT, text: include_str!("../page/shapes.js") },
    Asset { path: "/stale.js", media: JAVASCRIPT, text: include_str!("../page/stale.js") },
    Asset { path: "/view3d.js", media: JAVASCRIPT, text: include_str!("../page/view3d.js") },
    Asset {
        path: "/vendor/three.module.min.js",
        media: JAVASCRIPT,
        text: include_str!("../page/vendor/three.module.min.js"),
    },
    Asset {
        path: "/vendor/three.core.min.js",
        media: JAVASCRIPT,
        text: include_str!("../page/vendor/three.core.min.js"),
    },
    Asset {
        path: "/vendor/three.LICENSE",
        media: "text/plain; charset=utf-8",
        text: include_str!("../page/vendor/three.LICENSE"),
    },
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
    fn the_vendored_files_have_the_version_and_the_licence_of_their_description() {
        let description = include_str!("../page/vendor/README.md");
        let row = description.lines().find(|line| line.contains("three.module.min.js")).expect("a row");
        let revision =
            row.split("| 0.").nth(1).and_then(|rest| rest.split('.').next()).expect("a version 0.REVISION.0");
        let core = find("/vendor/three.core.min.js").expect("vendored").text;
        assert!(core.contains(&format!("const t=\"{revision}\"")), "not revision {revision}");
        assert!(find("/vendor/three.LICENSE").expect("vendored").text.starts_with("The MIT License"));
    }

    #[test]
    fn every_module_that_the_page_imports_is_served() {
        for asset in &ASSETS {
            let folder = asset.path.rsplit_once('/').map_or("", |(folder, _)| folder);
            for name in asset.text.split("from\"./").chain(asset.text.split("from \"./")).skip(1) {
                let Some(name) = name.split('"').next().filter(|name| name.ends_with(".js")) else { continue };
                assert!(find(&format!("{folder}/{name}")).is_some(), "{} imports {name}", asset.path);
            }
        }
    }

    #[test]
    fn the_page_refers_to_no_other_server() {
        for asset in &ASSETS {
            // Names of namespaces, and the link of a licence.
            let text = asset.text.replace("http://www.w3.org/", "");
            assert!(!text.contains("http://") && !text.contains("https://"), "{}", asset.path);
            assert!(!text.contains("//cdn"), "{}", asset.path);
        }
    }
}
