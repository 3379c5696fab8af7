//! The report in a real headless Chromium, driven through chromedriver: views, swipe, exposure, zoom, pan, read-out, theme.
//!
//! Needs Debian's `chromium` and `chromium-driver`; `tests/run` installs them.

mod webdriver;

use catoptric_diff::report::{Heading, html};
use catoptric_diff::{Limits, Params, compare};
use catoptric_image::{Image, srgb};
use webdriver::Browser;

const SIZE: [usize; 2] = [64, 48];
const TEST: f32 = 0.5;
const REFERENCE: f32 = 0.25;
/// One pixel of the test image stands out.
const SPOT: [usize; 2] = [30, 20];
/// The page opens at the exposure that brings the reference's 95th percentile to 0.9, in tenths of a stop.
const EXPOSURE: f32 = 1.8;

/// The report on a flat grey pair with one red pixel, in a folder that lives as long as the value.
fn report() -> (tempfile::TempDir, String) {
    let [width, height] = SIZE;
    let mut test = vec![[TEST; 3]; width * height];
    test[SPOT[1] * width + SPOT[0]] = [0.125, 0.0, 0.0];
    let reference = vec![[REFERENCE; 3]; width * height];
    let image = |pixels: &[[f32; 3]]| Image::from_rgb(width, height, pixels);
    let comparison = compare(image(&test), image(&reference), &Params::default()).expect("comparable");
    let checks = Limits::default().check(&comparison).expect("default limits");
    let heading = Heading { test: "out.exr", reference: "a & b.exr", checks: &checks, notes: &[] };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("report.html");
    std::fs::write(&path, html(&comparison, &heading)).expect("written");
    let url = format!("file://{}", path.display());
    (folder, url)
}

/// What the page shows of linear grey at an exposure.
fn shown(light: f32, ev: f32) -> i64 {
    i64::from(srgb::byte(light * ev.exp2()))
}

/// Red of the canvas pixel at fractions of its width and height.
fn red_at(browser: &Browser, x: f64, y: f64) -> i64 {
    let script = format!(
        "const c = document.getElementById('view'); \
         return c.getContext('2d').getImageData(Math.floor(c.width * {x}), Math.floor(c.height * {y}), 1, 1).data[0]"
    );
    browser.script(&script).as_i64().expect("a number")
}

fn data(browser: &Browser, name: &str) -> f64 {
    let text = browser.script(&format!("return document.getElementById('view').dataset.{name}"));
    text.as_str().and_then(|t| t.parse().ok()).unwrap_or_else(|| panic!("{name} is {text}"))
}

fn near(found: i64, expected: i64) -> bool {
    (found - expected).abs() <= 1
}

#[test]
fn the_report_works_in_a_browser_from_the_keyboard() {
    let (_folder, url) = report();
    let browser = Browser::start();
    browser.open(&url);
    assert_eq!(browser.script("return document.getElementById('verdict').textContent"), "outside limits");
    assert_eq!(
        browser.script("return performance.getEntriesByType('resource').length"),
        0,
        "the page fetched something"
    );
    browser.script("document.getElementById('view').focus()");

    // Swipe: the test image on the left of the line, the reference on the right.
    assert!(near(red_at(&browser, 0.45, 0.3), shown(TEST, EXPOSURE)));
    assert!(near(red_at(&browser, 0.55, 0.3), shown(REFERENCE, EXPOSURE)));
    browser.keys(&",".repeat(5));
    assert!((data(&browser, "swipe") - 0.4).abs() < 1e-9);
    assert!(near(red_at(&browser, 0.45, 0.3), shown(REFERENCE, EXPOSURE)), "the line did not move");
    browser.keys(&".".repeat(10));
    assert!(near(red_at(&browser, 0.55, 0.3), shown(TEST, EXPOSURE)));

    // Exposure, by key and by slider.
    browser.keys("[[[[");
    assert!(near(red_at(&browser, 0.45, 0.3), shown(TEST, EXPOSURE - 2.0)));
    browser.script("document.getElementById('exposure').focus()");
    browser.keys("\u{E014}"); // arrow right: a tenth of a stop
    assert!((data(&browser, "ev") - f64::from(EXPOSURE - 1.9)).abs() < 1e-6);
    assert!(near(red_at(&browser, 0.45, 0.3), shown(TEST, EXPOSURE - 1.9)));

    // Views: reference, and the heat map of a large difference is bright.
    browser.script("document.getElementById('view').focus()");
    browser.keys("5");
    assert!(near(red_at(&browser, 0.45, 0.3), shown(REFERENCE, EXPOSURE - 1.9)));
    browser.keys("7");
    let [red, blue] = ["0", "2"].map(|k| {
        let script = format!("const c = document.getElementById('view'); return c.getContext('2d').getImageData(c.width / 2, c.height / 4, 1, 1).data[{k}]");
        browser.script(&script).as_i64().expect("a number")
    });
    assert!(red > blue + 30, "brighter than the reference is not red: {red} {blue}");
    browser.keys("2");
    let phase = data(&browser, "phase");
    std::thread::sleep(std::time::Duration::from_millis(700));
    assert_ne!(data(&browser, "phase"), phase, "no flicker");
    browser.keys("4");

    // Read-out: the worst pixel is one button away, the arrows go on from there.
    let cell = |row: &str, k: usize| {
        let text = browser.script(&format!("return document.querySelectorAll('#{row} td')[{k}].textContent"));
        text.as_str().and_then(|t| t.parse::<f64>().ok()).unwrap_or_else(|| panic!("{row} {k} is {text}"))
    };
    let [x, y] = SPOT;
    browser.script(&format!(
        "[...document.querySelectorAll('.place')].find(b => b.dataset.x == {x} && b.dataset.y == {y}).click()"
    ));
    assert_eq!(browser.script("return document.getElementById('position').textContent"), format!("{x}, {y}"));
    assert_eq!(
        (cell("read-test", 0), cell("read-test", 1), cell("read-reference", 0)),
        (0.125, 0.0, f64::from(REFERENCE))
    );
    assert_eq!(cell("read-ratio", 0), 0.5);
    let spoken = browser.script("return document.getElementById('spoken').textContent");
    assert!(spoken.as_str().is_some_and(|s| s.starts_with("Pixel 30, 20")), "{spoken}");
    browser.keys("\u{E014}");
    assert_eq!(
        browser.script("return document.getElementById('position').textContent"),
        format!("{}, {y}", x + 1)
    );
    assert_eq!((cell("read-test", 0), cell("read-ratio", 3)), (f64::from(TEST), 2.0));

    // Zoom: the red pixel grows with it.
    let zoom = data(&browser, "zoom");
    let spot_area = || {
        let script = "const c = document.getElementById('view'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; \
                      let n = 0; for (let i = 0; i < d.length; i += 4) n += d[i] > 60 && d[i + 1] === 0 && d[i + 2] === 0; return n";
        browser.script(script).as_f64().expect("a number")
    };
    browser.keys("\u{E012}\u{E012}\u{E012}"); // move the read-out's frame off the spot
    let before = spot_area();
    browser.keys("+");
    assert!((data(&browser, "zoom") / zoom - 1.5).abs() < 1e-9);
    let growth = spot_area() / before;
    assert!((growth - 2.25).abs() < 0.6, "the pixel grew {growth} times");

    // Pan by mouse, fit by key.
    let centre = data(&browser, "x");
    browser.drag("view", [0, 40], [-120, 0]);
    assert!(
        (data(&browser, "x") - centre - 120.0 / data(&browser, "zoom")).abs() < 0.2,
        "{} {centre}",
        data(&browser, "x")
    );
    browser.script("document.getElementById('view').focus()");
    browser.keys("0");
    assert!((data(&browser, "x") - 32.0).abs() < 1e-9);

    // The theme button turns light into dark.
    let ground = || browser.script("return getComputedStyle(document.body).backgroundColor");
    let before = ground();
    browser.script("document.getElementById('theme').click()");
    assert_ne!(ground(), before);
    assert_eq!(
        browser.script("return document.querySelector('h1').textContent"),
        "out.exr against a & b.exr"
    );
}
