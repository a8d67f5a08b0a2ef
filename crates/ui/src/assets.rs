//! The files of the page, built into the program. The page loads nothing from other servers.

/// A file of the page.
pub(crate) struct Asset {
    pub path: &'static str,
    pub media: &'static str,
    pub text: &'static str,
}

/// All files.
static ASSETS: &[Asset] = &[
    Asset { path: "/", media: "text/html; charset=utf-8", text: include_str!("../page/index.html") },
    Asset { path: "/page.css", media: "text/css; charset=utf-8", text: include_str!("../page/page.css") },
    Asset { path: "/camera.js", media: JAVASCRIPT, text: include_str!("../page/camera.js") },
    Asset { path: "/charts.js", media: JAVASCRIPT, text: include_str!("../page/charts.js") },
    Asset { path: "/events.js", media: JAVASCRIPT, text: include_str!("../page/events.js") },
    Asset { path: "/fairness.js", media: JAVASCRIPT, text: include_str!("../page/fairness.js") },
    Asset { path: "/figures.js", media: JAVASCRIPT, text: include_str!("../page/figures.js") },
    Asset { path: "/geometry.js", media: JAVASCRIPT, text: include_str!("../page/geometry.js") },
    Asset { path: "/heat.js", media: JAVASCRIPT, text: include_str!("../page/heat.js") },
    Asset { path: "/labels.js", media: JAVASCRIPT, text: include_str!("../page/labels.js") },
    Asset { path: "/live.js", media: JAVASCRIPT, text: include_str!("../page/live.js") },
    Asset { path: "/motion.js", media: JAVASCRIPT, text: include_str!("../page/motion.js") },
    Asset { path: "/orders.js", media: JAVASCRIPT, text: include_str!("../page/orders.js") },
    Asset { path: "/outages.js", media: JAVASCRIPT, text: include_str!("../page/outages.js") },
    Asset { path: "/page.js", media: JAVASCRIPT, text: include_str!("../page/page.js") },
    Asset { path: "/plan2d.js", media: JAVASCRIPT, text: include_str!("../page/plan2d.js") },
    Asset { path: "/redraw.js", media: JAVASCRIPT, text: include_str!("../page/redraw.js") },
    Asset { path: "/requests.js", media: JAVASCRIPT, text: include_str!("../page/requests.js") },
    Asset { path: "/room.js", media: JAVASCRIPT, text: include_str!("../page/room.js") },
    Asset { path: "/scene.js", media: JAVASCRIPT, text: include_str!("../page/scene.js") },
    Asset { path: "/sentence.js", media: JAVASCRIPT, text: include_str!("../page/sentence.js") },
    Asset { path: "/shapes.js", media: JAVASCRIPT, text: include_str!("../page/shapes.js") },
    Asset { path: "/stale.js", media: JAVASCRIPT, text: include_str!("../page/stale.js") },
    Asset { path: "/stream.js", media: JAVASCRIPT, text: include_str!("../page/stream.js") },
    Asset { path: "/tips.js", media: JAVASCRIPT, text: include_str!("../page/tips.js") },
    Asset { path: "/worker.js", media: JAVASCRIPT, text: include_str!("../page/worker.js") },
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
    Asset {
        path: "/vendor/uPlot.iife.min.js",
        media: JAVASCRIPT,
        text: include_str!("../page/vendor/uPlot.iife.min.js"),
    },
    Asset {
        path: "/vendor/uPlot.min.css",
        media: "text/css; charset=utf-8",
        text: include_str!("../page/vendor/uPlot.min.css"),
    },
    Asset {
        path: "/vendor/uPlot.LICENSE",
        media: "text/plain; charset=utf-8",
        text: include_str!("../page/vendor/uPlot.LICENSE"),
    },
];

/// The media type of scripts.
pub(crate) const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

/// The file at a path.
pub(crate) fn find(path: &str) -> Option<&'static Asset> {
    ASSETS.iter().find(|asset| asset.path == path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vendored_files_have_the_version_and_the_licence_of_their_description() {
        let description = include_str!("../page/vendor/README.md");
        let row = description.lines().find(|line| line.contains("three.module.min.js")).expect("a row");
        let revision =
            row.split("| 0.").nth(1).and_then(|rest| rest.split('.').next()).expect("a version 0.REVISION.0");
        let core = find("/vendor/three.core.min.js").expect("vendored").text;
        assert!(core.contains(&format!("const t=\"{revision}\"")), "not revision {revision}");
        let row = description.lines().find(|line| line.contains("uPlot.iife.min.js")).expect("a row");
        let version = row.split(" | ").nth(2).expect("a version");
        let charts = find("/vendor/uPlot.iife.min.js").expect("vendored").text;
        assert!(charts.contains(&format!("(v{version})")), "not version {version}");
        for licence in ["/vendor/three.LICENSE", "/vendor/uPlot.LICENSE"] {
            assert!(find(licence).expect("vendored").text.starts_with("The MIT License"), "{licence}");
        }
    }

    #[test]
    fn every_module_that_the_page_imports_is_served() {
        for asset in ASSETS {
            let folder = asset.path.rsplit_once('/').map_or("", |(folder, _)| folder);
            for name in asset.text.split("from\"./").chain(asset.text.split("from \"./")).skip(1) {
                let Some(name) = name.split('"').next().filter(|name| name.ends_with(".js")) else { continue };
                assert!(find(&format!("{folder}/{name}")).is_some(), "{} imports {name}", asset.path);
            }
        }
    }

    #[test]
    fn the_page_works_below_any_path_of_a_site() {
        for asset in ASSETS.iter().filter(|asset| !asset.path.starts_with("/vendor/")) {
            // The icon is a picture in its own address, with the end of an element in it.
            let text = asset.text.replace("'/%3E", "");
            let absolute = ["\"/", "'/", "`/", "url(/"].into_iter().find(|start| text.contains(start));
            assert_eq!(absolute, None, "{} names a path of its host: expected a relative one", asset.path);
        }
    }

    #[test]
    fn the_page_refers_to_no_other_server() {
        for asset in ASSETS {
            // Names of namespaces, and the origin that a vendored file states in a comment.
            let text = asset.text.replace("http://www.w3.org/", "").replace("https://github.com/leeoniya/uPlot", "");
            assert!(!text.contains("http://") && !text.contains("https://"), "{}", asset.path);
            assert!(!text.contains("//cdn"), "{}", asset.path);
        }
    }
}
