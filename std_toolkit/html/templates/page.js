(function () {
  'use strict';

  // Plotly comes compressed with the page; browsers since 2023 unpack it.
  function draw() {
    var settings = {responsive: true, displaylogo: false, displayModeBar: false};
    document.querySelectorAll('script[data-plot]').forEach(function (s) {
      var figure = JSON.parse(s.textContent);
      window.Plotly.newPlot(s.dataset.plot, figure.data, figure.layout, settings);
    });
  }
  var packed = document.getElementById('plotly');
  if (packed && typeof DecompressionStream === 'undefined') {
    document.querySelectorAll('.plot').forEach(function (p) {
      p.textContent = 'This browser is too old to draw the figure.';
    });
  } else if (packed) {
    var bytes = Uint8Array.from(atob(packed.textContent.trim()), function (c) {
      return c.charCodeAt(0);
    });
    var stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
    new Response(stream).text().then(function (source) {
      var script = document.createElement('script');
      script.textContent = source;
      document.head.appendChild(script);
      draw();
    });
  }

  // Click a heading: sort, the measured and the published rows each among themselves.
  function value(row, column, numeric) {
    var cell = row.cells[column];
    if (!numeric) { return cell.textContent.toLowerCase(); }
    return cell.dataset.v === '' ? NaN : Number(cell.dataset.v);
  }
  document.querySelectorAll('table.sortable').forEach(function (table) {
    table.querySelectorAll('th').forEach(function (head, column) {
      head.tabIndex = 0;
      function sort() {
        var numeric = head.classList.contains('n');
        var now = head.getAttribute('aria-sort');
        var first = numeric && head.dataset.less === '0' ? 'descending' : 'ascending';
        var other = first === 'ascending' ? 'descending' : 'ascending';
        var way = now === first ? other : first;
        table.querySelectorAll('th').forEach(function (h) { h.removeAttribute('aria-sort'); });
        head.setAttribute('aria-sort', way);
        var sign = way === 'ascending' ? 1 : -1;
        Array.from(table.tBodies).forEach(function (body) {
          var rows = Array.from(body.rows);
          rows.sort(function (a, b) {
            var x = value(a, column, numeric), y = value(b, column, numeric);
            if (numeric && (isNaN(x) || isNaN(y))) { return isNaN(x) - isNaN(y); }
            return sign * (x < y ? -1 : x > y ? 1 : 0);
          });
          rows.forEach(function (row) { body.appendChild(row); });
        });
      }
      head.addEventListener('click', sort);
      head.addEventListener('keydown', function (e) { if (e.key === 'Enter') { sort(); } });
    });
  });

  // Rows of a table by the texts of some columns, and by any text.
  document.querySelectorAll('table[data-filters]').forEach(function (table) {
    var heads = Array.from(table.querySelectorAll('th'));
    var chosen = heads.filter(function (h) { return h.hasAttribute('data-filter'); });
    var rows = Array.from(table.querySelectorAll('tbody tr'));
    var bar = document.createElement('div'), left = document.createElement('span');
    bar.className = 'filters';
    function text(row, column) {
      var first = row.cells[column].firstChild;
      return first ? first.textContent.trim() : '';
    }
    function add(name, control) {
      var label = document.createElement('label');
      label.append(name, control);
      bar.append(label);
      control.addEventListener('input', apply);
    }
    var find = document.createElement('input');
    find.type = 'search';
    var tests = chosen.map(function (head) {
      var column = heads.indexOf(head), select = document.createElement('select');
      var values = new Set(rows.map(function (row) { return text(row, column); }));
      select.append(new Option('all', ''));
      Array.from(values).sort().forEach(function (v) {
        select.append(new Option(v || '-', v || '-'));
      });
      add(head.firstChild.textContent, select);
      return function (row) { return !select.value || (text(row, column) || '-') === select.value; };
    });
    tests.push(function (row) {
      return row.textContent.toLowerCase().includes(find.value.trim().toLowerCase());
    });
    function apply() {
      rows.forEach(function (row) {
        row.hidden = !tests.every(function (test) { return test(row); });
      });
      var shown = rows.filter(function (row) { return !row.hidden; }).length;
      left.textContent = shown < rows.length ? shown + ' of ' + rows.length + ' rows' : '';
    }
    add('find', find);
    bar.append(left);
    table.parentNode.before(bar);
  });

  // Click a picture: enlarge it. The key o hides the outlines.
  var dialog = document.getElementById('large');
  function fit(frame, w, h) {
    var k = Math.min(dialog.clientWidth / w, dialog.clientHeight / h);
    frame.style.width = w * k + 'px'; frame.style.height = h * k + 'px';
  }
  document.querySelectorAll('main .picture').forEach(function (p) {
    p.addEventListener('click', function () {
      var holder = document.createElement('div'), frame = document.createElement('div');
      holder.className = 'picture'; frame.className = 'frame';
      frame.innerHTML = p.innerHTML; holder.appendChild(frame);
      dialog.replaceChildren(holder); dialog.showModal();
      fit(frame, +p.dataset.w, +p.dataset.h);
    });
  });
  dialog.addEventListener('click', function () { dialog.close(); });
  var box = document.getElementById('outlines');
  if (box) {
    var apply = function () { document.body.classList.toggle('plain', !box.checked); };
    box.addEventListener('change', apply);
    document.addEventListener('keydown', function (e) {
      if (e.key !== 'o' || e.ctrlKey || e.metaKey || e.altKey) { return; }
      box.checked = !box.checked; apply();
    });
  }
})();
